"""Every error that pellucid raises on purpose: one line that says what was asked, what was found, what to do."""

from __future__ import annotations

import difflib
import os
import re
import sys
import warnings
from collections.abc import Iterable
from importlib import import_module
from typing import Any


class PellucidError(Exception):
    """Base of all errors a user can cause; the command line prints its text and exits with 2."""


class EnvironmentProblem(PellucidError):
    """The machine lacks something: LLVM, a variant, an optional package."""


class MediumError(PellucidError, ValueError):
    """A material that cannot exist, or a name that is not in the table."""


class SceneError(PellucidError, ValueError):
    """A scene, mesh or texture that cannot be rendered as it is."""


class SampleCountError(SceneError):
    """More surface samples are needed than are allowed, most often because of a unit mistake."""


class OutputError(PellucidError, OSError):
    """A picture or table that cannot be written where it was asked for."""


class ClusterError(PellucidError):
    """A cluster that is not to be reached, is lost, or has workers that cannot take part."""


class PellucidWarning(UserWarning):
    """The picture will be made, but something about it deserves a second look."""


INSIDE = ("pellucid", "mitsuba", "drjit", "importlib")


def warn(text: str) -> None:
    """Give a `PellucidWarning` that names the line which called the package, directly or by way of Mitsuba."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in INSIDE:
        frame = frame.f_back
    registry = frame.f_globals.setdefault("__warningregistry__", {})
    module = frame.f_globals.get("__name__", "<unknown>")
    warnings.warn_explicit(text, PellucidWarning, frame.f_code.co_filename, frame.f_lineno, module, registry)


def install(extra: str) -> str:
    """Say how to install the optional packages of an ``extra``; no index has this package yet."""
    return f"pip install '.[{extra}]' in a checkout of pellucid"


def import_optional(module: str, otherwise: str) -> Any:
    """Import a package that only some of the work needs.

    Raises
    ------
    EnvironmentProblem
        Where it is not installed: ``otherwise``, which says what needs it and what to do.
    """
    try:
        return import_module(module)
    except ImportError:
        raise EnvironmentProblem(otherwise) from None


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggest the nearest of the ``known`` names inside a message: ``" (did you mean 'marble'?)"``, or nothing."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def first_cause(text: str) -> str:
    """Reduce Mitsuba's report of what failed to one line: the exception that started it, or all of it on one line."""
    _, is_python, trace = text.partition("Traceback (most recent call last):")
    if is_python:
        cause = next((line for line in trace.splitlines() if line and not line[0].isspace()), text)
        return re.sub(r"^[\w.]+: ", "", cause)
    text = re.sub(r"\[(?:[\w.]+:\d+|[A-Z]\w+)\] ", "", " ".join(text.split()))
    text = re.sub(r'"\w+Stream\[ path = ("[^"]*")[^]]*\]"', r"\1", text)
    text = re.sub(r"(Error while loading [^:]+: while processing <include>: )\1+", r"\1", text)
    text = re.sub(r"I/O error while attempting to [\w ]+: ", "", text)
    text = re.sub(r'("[^"]+"): (?:Success|No such file or directory)!?$', _unread, text)
    return re.sub(r'("[^"]+"): read \d+ out of \d+ bytes', r"\1 ends too early: it is cut off, or something else", text)


def _unread(match: re.Match[str]) -> str:
    """Say of a file that it is damaged, where Mitsuba gives the last error of the system, which was about something else."""
    return f"{match[1]} cannot be read: it is damaged" if os.path.exists(match[1].strip('"')) else match[0]

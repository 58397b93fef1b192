"""The command ``pellucid``: its list of commands, and what becomes of warnings, errors and Ctrl-C."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from ..errors import PellucidError, PellucidWarning
from ..version import __version__
from .cite import cite
from .compare import compare
from .doctor import doctor
from .export import export
from .fit import fit
from .interrupts import INTERRUPTED, ended_by_many
from .materials import materials
from .merge import merge
from .render import render
from .samples import samples
from .turntable import turntable
from .view import view

BAD_INPUT = 2

EXAMPLES = """\b
Examples:
  pellucid render teapot
  pellucid render bunny.ply --material skin1 --size 80 -o bunny.png -o bunny.exr
  pellucid render scene.xml -D albedo=skin.png --spp 64
  pellucid compare teapot --samples 20000
  pellucid turntable teapot --frames 60 -o teapot.mp4
  pellucid view teapot
  pellucid export bunny.ply -o bunny.html
"""


class Commands(click.Group):
    """A group whose errors take one line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; Ctrl-C ends it with one line, which says what is left of its work."""
        try:
            with ended_by_many():
                return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            _say(f"interrupted: {str(interrupt) or 'nothing was written'}")
            raise click.exceptions.Exit(INTERRUPTED) from None

    def main(self, *args: Any, **extra: Any) -> NoReturn:
        """Run a command and leave with its exit code."""
        extra["standalone_mode"] = False
        for name in ("stdout", "stderr"):  # none where the shell has closed it
            if getattr(sys, name) is None:
                setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        for stream in (sys.stdout, sys.stderr):  # names of files can hold bytes that are no characters
            if isinstance(stream, io.TextIOWrapper):
                stream.reconfigure(errors="backslashreplace")
        try:
            with _one_line_warnings():
                code = super().main(*args, **extra)
        except click.exceptions.NoArgsIsHelpError as request:
            request.show()
            code = BAD_INPUT
        except click.UsageError as error:
            where = f" (see '{error.ctx.command_path} --help')" if error.ctx else ""
            _say(f"error: {_text(error).rstrip('.')}{where}")
            code = BAD_INPUT
        except (PellucidError, click.ClickException) as error:
            _say(f"error: {_text(error)}")
            code = BAD_INPUT
        except OSError as error:  # standard output that takes nothing more, as a full disk
            named = f"'{error.filename}': " if error.filename else ""
            _say(f"error: {named}{error.strerror or error}.")
            # When Python ends it writes what its buffer still holds, and would fail again.
            if sys.__stdout__ is not None and sys.stdout is sys.__stdout__:
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())
            code = BAD_INPUT
        sys.exit(code if isinstance(code, int) else 0)


def _text(error: Exception) -> str:
    """Read the message of an error, in one line."""
    text = error.format_message() if isinstance(error, click.ClickException) else str(error)
    return " ".join(text.split())


def _say(line: str) -> None:
    """Write one line to standard error."""
    click.echo(line, err=True)


@contextmanager
def _one_line_warnings() -> Iterator[None]:
    """Show our own warnings as one line each; the others stay as Python shows them."""

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, PellucidWarning):
            _say(f"warning: {' '.join(str(message).split())}")
        else:
            as_python(message, category, *place, **more)

    with warnings.catch_warnings():
        as_python = warnings.showwarning
        warnings.showwarning = show
        warnings.simplefilter("always", PellucidWarning)
        yield


@click.group(cls=Commands, epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message="%(prog)s %(version)s")
def pellucid() -> None:
    """Render translucent materials: marble, milk, skin, wax, jade."""


for _command in (render, view, export, fit, compare, samples, turntable, merge, materials, cite, doctor):
    pellucid.add_command(_command)

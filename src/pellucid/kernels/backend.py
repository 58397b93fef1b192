"""The variants of Mitsuba that can run the methods."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .. import _llvm
from ..errors import EnvironmentProblem, did_you_mean

CANDIDATES = ("llvm_ad_rgb", "cuda_ad_rgb", "metal_ad_rgb")
"""Variants in the order in which they are tried where none is named."""

FEWEST_THREADS = 2
"""Mitsuba reads and writes OpenEXR files by tasks that the calling thread waits for and does not work on: alone, it waits for ever."""


def ensure_threads() -> None:
    """Let Dr.Jit have the threads that Mitsuba needs to read and write pictures, on a machine of one core too."""
    if dr.thread_count() < FEWEST_THREADS:
        dr.set_thread_count(FEWEST_THREADS)


def supported(variant: str) -> bool:
    """Tell whether a variant can run the methods: compiled, and with red, green and blue."""
    return variant.endswith("_ad_rgb") and not variant.startswith("scalar")


def obstacle(variant: str) -> str | None:
    """Say why a variant cannot run here; None where it can."""
    if variant not in mi.variants():
        return f"Mitsuba {mi.__version__} has no such variant on this system"
    if not supported(variant):
        return "pellucid needs a compiled RGB variant"
    if variant.startswith("llvm"):
        try:
            _llvm.require()
        except EnvironmentProblem as problem:
            return str(problem)
    elif not dr.has_backend(dr.JitBackend.CUDA if variant.startswith("cuda") else dr.JitBackend.Metal):
        return "no CUDA device and driver were found" if variant.startswith("cuda") else "no Metal device was found"
    return None


def default_variant() -> str:
    """Find the first of the candidates that works.

    Raises
    ------
    EnvironmentProblem
        When none does, with the reasons.
    """
    obstacles = {variant: obstacle(variant) for variant in CANDIDATES}
    for variant, reason in obstacles.items():
        if reason is None:
            return variant
    reasons = "; ".join(f"{variant}: {str(reason).rstrip('.')}" for variant, reason in obstacles.items())
    raise EnvironmentProblem(f"No variant of Mitsuba works here. {reasons}.")


def choose_variant(name: str | None = None) -> str:
    """Activate a variant of Mitsuba, by default the first that works, and return its name.

    Raises
    ------
    EnvironmentProblem
        For a variant that this Mitsuba does not have, cannot run here, or that the methods cannot use.
    """
    if name is None:
        name = default_variant()
    else:
        reason = obstacle(name)
        if reason is not None:
            usable = [variant for variant in mi.variants() if supported(variant) and not obstacle(variant)]
            known = [variant for variant in mi.variants() if supported(variant)] if name not in mi.variants() else []
            remedy = f"; usable are {', '.join(usable)}" if usable else ""
            raise EnvironmentProblem(f"-m {name}: {reason.rstrip('.')}{did_you_mean(name, known)}{remedy}.")
    mi.set_variant(name)
    return name

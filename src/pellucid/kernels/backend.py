"""The variants of Mitsuba that can run the methods."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .. import _llvm
from ..errors import EnvironmentProblem, did_you_mean

DEFAULT_VARIANT = "llvm_ad_rgb"


def supported(variant: str) -> bool:
    """Tell whether a variant can run the methods: compiled, and with red, green and blue."""
    return variant.endswith("_ad_rgb") and not variant.startswith("scalar")


def choose_variant(name: str) -> None:
    """Activate a variant of Mitsuba.

    Raises
    ------
    EnvironmentProblem
        For a variant that this Mitsuba does not have, cannot run here, or that the methods cannot use.
    """
    usable = [variant for variant in mi.variants() if supported(variant)]
    if name not in usable:
        if name in mi.variants():
            found = "pellucid needs a compiled RGB variant"
        else:
            found = f"Mitsuba {mi.__version__} has no such variant{did_you_mean(name, usable)}"
        raise EnvironmentProblem(f"-m {name}: {found}; usable are {', '.join(usable)}.")
    if name.startswith("llvm"):
        _llvm.require()
    elif not dr.has_backend(dr.JitBackend.CUDA):
        raise EnvironmentProblem(f"-m {name}: no CUDA device and driver were found; use -m {DEFAULT_VARIANT}.")
    mi.set_variant(name)

"""The methods, by name, and the plug-ins that are made of them. They register themselves with every variant that becomes active."""

from __future__ import annotations

import importlib
import sys
from threading import RLock
from typing import Any

import mitsuba as mi

from .. import _llvm
from ..errors import EnvironmentProblem, PellucidError, did_you_mean
from ..kernels.backend import supported

BSDF = "pellucid_translucent"
METHODS = {
    "two_pass": "pellucid.methods.two_pass:TwoPass",
    "exact": "pellucid.methods.exact:Exact",
    "sampled": "pellucid.methods.sampled:Sampled",
    "single_pass": "pellucid.methods.single_pass.integrator:SinglePass",
    "texture_space": "pellucid.methods.texture_space.integrator:TextureSpace",
}
"""Where the class of each method is; it is imported on first use. The plug-in of a method is called ``pellucid_`` and its name."""


def register_method(name: str, where: str) -> None:
    """Add a method: the class at ``where``, written ``module:Class``, derives from `contract.Method`."""
    METHODS[name] = where
    if mi.variant():
        _register_integrator(name, mi.variant())


def method_class(name: str) -> Any:
    """Import the class of a method.

    Raises
    ------
    PellucidError
        For a name that no method has.
    """
    if name not in METHODS:
        raise PellucidError(f"There is no method '{name}'{did_you_mean(name, METHODS)}. Known: {', '.join(METHODS)}.")
    module, _, cls = METHODS[name].partition(":")
    with _importing:
        return getattr(importlib.import_module(module), cls)


def register(variant: str) -> None:
    """Register all plug-ins with a variant that has just become active.

    Raises
    ------
    EnvironmentProblem
        When it is a variant that the methods can use, and the LLVM that would compile them ends the process.
    """
    if supported(variant) and variant.startswith("llvm"):
        _llvm.require()
    _current.clear()
    for name in METHODS:
        _register_integrator(name, variant)
    if supported(variant):
        mi.register_bsdf(BSDF, lambda props: _of_variant("translucent").TranslucentBSDF(props))
    else:
        mi.register_bsdf(BSDF, _refuse(variant))


def _register_integrator(name: str, variant: str) -> None:
    """Register the plug-in of one method."""
    if supported(variant):
        mi.register_integrator(
            f"pellucid_{name}", lambda props: _of_variant("integrator").TranslucentIntegrator(props, method_class(name))
        )
    else:
        mi.register_integrator(f"pellucid_{name}", _refuse(variant))


_current: set[str] = set()
_importing = RLock()
"""Held while a module is imported: Mitsuba makes the plug-ins of a scene in several threads, and two that import the modules of one
package at once may find one of them half done."""


def _of_variant(name: str) -> Any:
    """Import a module whose classes derive from classes of the active variant: each variant executes it anew, on first use."""
    full = f"{__name__}.{name}"
    with _importing:
        if name not in _current:
            importlib.reload(sys.modules[full]) if full in sys.modules else importlib.import_module(full)
            _current.add(name)
    return sys.modules[full]


def _refuse(variant: str):
    """Make a constructor that says which variants can be used."""

    def construct(props):
        raise EnvironmentProblem(
            f"pellucid needs a compiled RGB variant, the active one is {variant}: call mitsuba.set_variant('llvm_ad_rgb') "
            "or 'cuda_ad_rgb' before loading the scene."
        )

    return construct

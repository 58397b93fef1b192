"""The Mitsuba plug-ins: one method, one file. They register themselves with every variant that becomes active."""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

from ..errors import EnvironmentProblem
from ..kernels.backend import supported

BSDF = "pellucid_translucent"
METHODS = {
    "two_pass": ("two_pass", "TwoPassIntegrator"),
    "exact": ("exact", "ExactIntegrator"),
    "sampled": ("sampled", "SampledIntegrator"),
    "single_pass": ("single_pass.integrator", "SinglePassIntegrator"),
    "texture_space": ("texture_space.integrator", "TextureSpaceIntegrator"),
}
"""Method name to (module, class); its plug-in is called ``pellucid_`` and the name."""


def register(variant: str) -> None:
    """Register all plug-ins with a variant that has just become active."""
    if not supported(variant):
        for name in METHODS:
            mi.register_integrator(f"pellucid_{name}", _refuse(variant))
        mi.register_bsdf(BSDF, _refuse(variant))
        return
    mi.register_bsdf(BSDF, lambda props: _load("translucent").TranslucentBSDF(props))
    for name, (module, cls) in METHODS.items():
        mi.register_integrator(
            f"pellucid_{name}", lambda props, module=module, cls=cls: getattr(_load("contract", module), cls)(props)
        )
    _executed.clear()


_executed: set[str] = set()


def _load(*modules: str):
    """Import modules for the active variant, on first use, and return the last of them.

    Their classes derive from classes of the active variant, so each variant executes them anew.
    """
    for name in modules:
        full = f"{__name__}.{name}"
        if name not in _executed:
            importlib.reload(sys.modules[full]) if full in sys.modules else importlib.import_module(full)
            _executed.add(name)
    return sys.modules[f"{__name__}.{modules[-1]}"]


def _refuse(variant: str):
    """Make a constructor that says which variants can be used."""

    def construct(props):
        raise EnvironmentProblem(
            f"pellucid needs a compiled RGB variant, the active one is {variant}: call mitsuba.set_variant('llvm_ad_rgb') "
            "or 'cuda_ad_rgb' before loading the scene."
        )

    return construct

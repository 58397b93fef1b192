"""Fast rendering of translucent materials for Mitsuba 3: marble, milk, skin, wax, jade.

Importing the package registers the BSDF ``pellucid_translucent`` and the integrators ``pellucid_two_pass``,
``pellucid_exact`` and ``pellucid_sampled`` with every Mitsuba variant that is or becomes active. It sets none itself.
"""

from importlib import import_module
from typing import Any

from . import _llvm

_llvm.point_to_wheel()  # before anything imports drjit

import mitsuba as _mi  # noqa: E402

from . import methods as _methods  # noqa: E402
from .errors import PellucidError, PellucidWarning  # noqa: E402
from .version import __version__  # noqa: E402

# Loaded on first use: they cost time, and parts of them need an active variant.
_LAZY = {
    "Medium": ".model.medium",
    "Prepared": ".api",
    "prepare": ".api",
    "load_scene": ".scenes.loading",
}
__all__ = ["Medium", "PellucidError", "PellucidWarning", "Prepared", "__version__", "load_scene", "prepare"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name], __name__), name)
    raise AttributeError(f"module 'pellucid' has no attribute '{name}'")


_mi.detail.add_variant_callback(lambda old, new: _methods.register(new) if new else None)
if _mi.variant():
    _methods.register(_mi.variant())

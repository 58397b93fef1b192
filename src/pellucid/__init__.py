"""Fast rendering of translucent materials for Mitsuba 3: marble, milk, skin, wax, jade.

Importing the package registers the BSDF ``pellucid_translucent`` and an integrator ``pellucid_<method>`` for each method
with every Mitsuba variant that is or becomes active. It sets none itself.

What is public is in ``dir(pellucid)``: `load_scene` loads a scene, `prepare` makes a `Prepared` scene that answers with its
exitance at any point, `render_layers` renders a picture with its `Layers`, one of which is the picture without noise; a `Cluster`
renders on many machines; `fit` measures a medium from photographs, a `Fit`; `Medium` is a translucent material, an `Engine` makes
frames in real time as a `Camera` sees them;
`PellucidError` is the base of all errors, and `PellucidWarning` the class of all warnings.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from . import (
    _kernel_folder,  # noqa: F401  before anything imports drjit
    _llvm,
)

_llvm.check_folder()
_llvm.point_to_wheel()  # before anything imports drjit

import mitsuba as _mi  # noqa: E402

from . import methods as _methods  # noqa: E402
from .errors import PellucidError, PellucidWarning  # noqa: E402
from .kernels import backend as _backend  # noqa: E402
from .version import __version__  # noqa: E402

if TYPE_CHECKING:
    from .api import Prepared, prepare, render_layers
    from .cluster.cluster import Cluster
    from .fitting.fit import fit
    from .fitting.result import Fit
    from .methods.layers import Layers
    from .model.medium import Medium
    from .realtime.engine import Engine
    from .realtime.source import Camera
    from .scenes.loading import load_scene

# Loaded on first use: they cost time, and parts of them need an active variant.
_LAZY = {
    "Camera": ".realtime.source",
    "Cluster": ".cluster.cluster",
    "Engine": ".realtime.engine",
    "Fit": ".fitting.result",
    "Layers": ".methods.layers",
    "Medium": ".model.medium",
    "Prepared": ".api",
    "fit": ".fitting.fit",
    "load_scene": ".scenes.loading",
    "prepare": ".api",
    "render_layers": ".api",
}
__all__ = [
    "Camera",
    "Cluster",
    "Engine",
    "Fit",
    "Layers",
    "Medium",
    "PellucidError",
    "PellucidWarning",
    "Prepared",
    "__version__",
    "fit",
    "load_scene",
    "prepare",
    "render_layers",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name], __name__), name)
    raise AttributeError(f"module 'pellucid' has no attribute '{name}'")


def __dir__() -> list[str]:
    return __all__


_backend.ensure_threads()
_mi.detail.add_variant_callback(lambda old, new: _methods.register(new) if new else None)
if _mi.variant():
    _methods.register(_mi.variant())

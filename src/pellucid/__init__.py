"""Fast rendering of translucent materials for Mitsuba 3: marble, milk, skin, wax, jade.

Importing the package registers the BSDF ``pellucid_translucent`` and the integrators ``pellucid_two_pass``,
``pellucid_exact`` and ``pellucid_sampled`` with every Mitsuba variant that is or becomes active.
"""

from . import _llvm

_llvm.point_to_wheel()  # before anything imports drjit

import mitsuba as _mi  # noqa: E402

from . import integrators as _integrators  # noqa: E402
from .errors import PellucidError, PellucidWarning  # noqa: E402
from .model.medium import Medium  # noqa: E402

__version__ = "0.1.0"
__all__ = ["Medium", "PellucidError", "PellucidWarning", "__version__"]

_mi.detail.add_variant_callback(lambda old, new: _integrators.register(new) if new else None)
if _mi.variant():
    _integrators.register(_mi.variant())

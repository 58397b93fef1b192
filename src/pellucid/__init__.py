"""Fast rendering of translucent materials for Mitsuba 3."""

from . import _llvm

_llvm.point_to_wheel()

__version__ = "0.1.0"

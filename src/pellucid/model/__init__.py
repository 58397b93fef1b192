"""Floor 0, what a translucent material is: media, the boundary, profiles, single scattering, photons."""

from .materials import PRESETS
from .medium import Medium
from .profiles import ProfileTable
from .validity import validity

__all__ = ["PRESETS", "Medium", "ProfileTable", "validity"]

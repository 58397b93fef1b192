"""What triple cuts read besides the two trees: strengths, representatives, and the profile."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ....gather.source import Source, make_source
from ....kernels.memory import upload
from ....model.profiles import ProfileTable
from ..trees.binary import sum_up
from ..trees.light_tree import LightTree
from ..trees.sample_tree import SampleTree
from .representatives import light_strength, spread_representatives, upload_representatives


@dataclass
class CutTables:
    """What the cuts of one prototype read, besides the two trees.

    Attributes
    ----------
    profile, bound : Source
        R_d, and what bounds it whatever the normals are, without any samples.
    strength : Float
        A float4 a node of the sample tree: ``sum B_j`` in red, green, blue.
    sample_choices, light_choices : UInt32
        Representatives of irradiance clusters and of light clusters.
    leaves_opaque, last_opaque, depth_opaque, light_depth_opaque : UInt32
        Leaves of the sample tree, its last sample, and the depths of both trees, as inputs of kernels.
    bits : UInt32
        Random bits of the seed.
    first_key : int
        Where the keys of this prototype begin in a cache that prototypes share; as `keys` counts them.
    """

    samples: SampleTree
    lights: LightTree
    profile: Source
    bound: Source
    strength: mi.Float
    sample_choices: mi.UInt32
    light_choices: mi.UInt32
    leaves_opaque: mi.UInt32
    last_opaque: mi.UInt32
    depth_opaque: mi.UInt32
    light_depth_opaque: mi.UInt32
    bits: mi.UInt32
    first_key: int

    @classmethod
    def build(
        cls, samples: SampleTree, lights: LightTree, table: ProfileTable, seed: int = 0, first_key: int = 0
    ) -> CutTables:
        """Choose representatives, and sum strengths: ``B_j`` is the area of a sample times its colour.

        The Fresnel factor of the paper's strength is part of the irradiance link here, exact for each direction.

        Source: AWB08 section 4.2.4, 5.1.
        """
        strength = samples.area[:, None] * samples.colour.astype(np.float64)
        records = np.zeros((2 * samples.leaves, 4), np.float32)
        records[:, :3] = sum_up(strength, samples.depth)
        total = np.zeros(samples.leaves)
        total[: samples.count] = strength.sum(axis=1)
        profile = make_source(dr.empty(mi.Float, 4), 0, table, mi.Float)
        bound = profile if table.curve is None else make_source(profile.records, 0, table.bounding(), mi.Float)
        # Clusters without samples have representatives beyond the last one, which kernels fetch all the same.
        chosen = np.minimum(spread_representatives(total, samples.depth, seed), samples.count - 1)
        return cls(
            samples,
            lights,
            profile,
            bound,
            upload(records, mi.Float),
            upload_representatives(chosen),
            upload_representatives(spread_representatives(light_strength(lights), lights.depth, seed)),
            dr.opaque(mi.UInt32, samples.leaves),
            dr.opaque(mi.UInt32, samples.count - 1),
            dr.opaque(mi.UInt32, samples.depth),
            dr.opaque(mi.UInt32, lights.depth),
            dr.opaque(mi.UInt32, np.random.default_rng(seed).integers(1 << 32)),
            first_key,
        )

    def keys(self, instances: int) -> int:
        """Count the irradiance links between all clusters of samples of so many instances and all clusters of lights."""
        return instances * 2 * self.samples.leaves * 2 * self.lights.leaves

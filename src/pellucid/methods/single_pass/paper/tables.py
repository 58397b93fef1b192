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
from .representatives import eye_representatives, light_representatives, representatives, upload_representatives


@dataclass
class CutTables:
    """What the cuts of one prototype read, besides the two trees.

    Attributes
    ----------
    profile, bound : Source
        R_d, and what bounds it whatever the normals are, without any samples.
    strength : Float
        A float4 a node of the sample tree: ``sum B_j`` in red, green, blue, and the representative of irradiance links.
    eye_choices, light_choices : UInt32
        Representatives of irradiance clusters in BSSRDF links, and of light clusters.
    leaves_opaque, depth_opaque : UInt32
        Of the sample tree, as inputs of kernels.
    first_key : int
        Where the keys of this prototype begin in a cache that prototypes share; as `keys` counts them.
    """

    samples: SampleTree
    lights: LightTree
    profile: Source
    bound: Source
    strength: mi.Float
    eye_choices: mi.UInt32
    light_choices: mi.UInt32
    leaves_opaque: mi.UInt32
    depth_opaque: mi.UInt32
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
        chosen = representatives(total, samples.depth, 1, seed)
        # Clusters without samples have representatives beyond the last one, which kernels fetch all the same.
        last = samples.count - 1
        records.view(np.uint32)[:, 3] = np.minimum(chosen[:, 0], last)
        return cls(
            samples,
            lights,
            profile,
            bound,
            upload(records, mi.Float),
            upload_representatives(np.minimum(eye_representatives(total, samples.depth, seed), last)),
            upload_representatives(light_representatives(lights, seed)),
            dr.opaque(mi.UInt32, samples.leaves),
            dr.opaque(mi.UInt32, samples.depth),
            first_key,
        )

    def keys(self, instances: int) -> int:
        """Count the irradiance links between all samples of so many instances and all lights."""
        return instances * self.samples.leaves * self.lights.leaves

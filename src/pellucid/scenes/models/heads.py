"""Four heads as signed distances: horned, with a carved relief, of a bearded philosopher, and antique.

Millimetres: z is up, and they look along -y.
"""

from __future__ import annotations

import numpy as np

from ..bust.shape import face_distance
from ..shapes.distance import Floats, about, capsule, cut, disc, ellipsoid, mirrored, tube, union, weathering


def horned_head(p: Floats) -> Floats:
    """Distance to the head of a bull whose horns end in points."""
    m = mirrored(p)
    d = ellipsoid(p, (0, 30, 20), (52, 62, 50))
    d = union(d, capsule(p, (0, 0, 5), (0, -95, -62), 42, 27), 30)
    d = union(d, ellipsoid(p, (0, -104, -68), (34, 25, 26)), 14)
    d = union(d, capsule(m, (20, 10, -34), (10, -78, -84), 20, 13), 16)
    d = union(d, capsule(m, (6, -26, 50), (46, -12, 38), 12, 11), 14)
    d = union(d, ellipsoid(p, (0, 6, 64), (26, 24, 16)), 14)
    d = cut(d, ellipsoid(m, (48, -42, 13), (9, 17, 12)), 10)
    d = union(d, ellipsoid(m, (28, -40, 13), (11, 13, 10)), 5)
    d = cut(d, ellipsoid(m, (17, -128, -60), (7, 9, 5.5)), 6)
    mouth = (p[2] + 0.1 * p[1] + 92) / 3
    d = d + 2.6 * np.exp(-(mouth**2)) / (1 + np.exp((p[1] + 84) / 3))
    neck = capsule(p, (0, 50, 10), (0, 118, -34), 50, 56)
    d = cut(union(d, neck, 26), 96 - 0.87 * p[1] + 0.49 * p[2], 12)
    q = about(m, (74, 22, 24), -0.3, axis=1)
    ear = cut(ellipsoid(q, (0, 0, 0), (34, 10, 16)), ellipsoid(q, (4, -11, 0), (25, 8, 9)), 6)
    horn = [(26, 12, 54), (62, 6, 68), (94, -4, 92), (106, -18, 128), (92, -36, 166)]
    return union(union(d, ear, 8), tube(m, horn, (18, 15.5, 12, 7.5, 1.8)), 9)


def _whole_face(p: Floats) -> Floats:
    """Distance to the head without hair, full between jaw and ear, where the bust has its hair."""
    return union(face_distance(p), ellipsoid(mirrored(p), (46, 6, -46), (22, 30, 36)), 18)


def relief_head(p: Floats) -> Floats:
    """Distance to a bald head with spirals carved into it, all over but for eyes, nose and lips."""
    q = np.stack([p[0] * 1.04, p[1], p[2] * 0.94])
    x, y, z = mirrored(q)
    phase = np.pi / 8 * (np.hypot(y - 12, z - 40) + 8 / np.pi * np.arctan2(z - 40, y - 12))
    face = np.exp(-(((x / 46) ** 2 + ((y + 88) / 40) ** 2 + ((z + 30) / 58) ** 2) ** 2))
    ears = np.exp(-((((x - 78) / 16) ** 2 + ((y - 16) / 26) ** 2 + ((z + 14) / 36) ** 2) ** 2))
    groove = 3.2 * (1 - face) * (1 - ears) * np.exp(-((np.sin(0.5 * phase) / 0.5) ** 2))
    d = union(_whole_face(q) + groove, ellipsoid(q, (0, 26, -178), (76, 70, 30)), 16)
    return cut(d, z + 166, 10)


def philosopher(p: Floats) -> Floats:
    """Distance to the bust of an old man with a beard, on a round foot."""
    q = np.stack([p[0] * 0.97, p[1], p[2] * 0.97])
    m = mirrored(q)
    x, y, z = m
    d = _whole_face(q)
    d = union(d, capsule(m, (12, -82, 17), (44, -69, 17), 6, 5), 7)
    d = union(d, ellipsoid(q, (0, -104, -38), (9, 9, 9)), 6)
    beard = ellipsoid(q, (0, -58, -108), (54, 38, 48))
    beard = union(beard, capsule(q, (0, -66, -118), (0, -56, -170), 34, 16), 24)
    beard = union(beard, capsule(m, (66, -10, -20), (44, -44, -92), 12, 26), 16)
    beard = beard + 2.6 * np.sin(0.34 * x + 1.7 * np.sin(0.075 * z + 0.03 * x)) - 1
    lips = ellipsoid(q, (0, -104, -76), (17, 14, 4))
    moustache = capsule(m, (3, -99, -58), (36, -78, -88), 7.5, 5)
    d = union(d, cut(union(beard, moustache, 5), lips, 5), 6)
    hair = ellipsoid(q, (0, 22, 4), (82, 94, 66))
    hair = cut(hair, ellipsoid(q, (0, -84, 20), (86, 88, 110)), 16)
    hair = cut(hair, ellipsoid(q, (0, -4, 108), (86, 100, 66)), 20)
    d = union(d, hair + 2.4 * np.sin(0.20 * z + 2.2 * np.sin(0.05 * (y + x))), 8)
    folds = np.sin(0.13 * q[0] + 0.09 * z + 0.6 * np.sin(0.04 * q[0]))
    cloth = ellipsoid(q, (0, 30, -190), (132, 80, 68)) + 3.2 * folds
    d = cut(union(d, cloth, 10), z + 198, 12)
    foot = union(disc(q, (0, 30, -256), 66, 18, 10), disc(q, (0, 30, -220), 36, 80, 6), 24)
    return union(d, foot, 12)


def antique_head(p: Floats) -> Floats:
    """Distance to the head of a marble statue, broken off at the neck, its waves of hair tied by a band; weathered."""
    q = np.stack([p[0] * 1.03, p[1] * 1.02, p[2]])
    x, y, z = mirrored(q)
    hair = ellipsoid(q, (0, 18, 36), (84, 101, 85))
    hair = cut(hair, ellipsoid(q, (0, -92, -34), (60, 70, 86)), 10)
    hair = cut(hair, ellipsoid(q, (0, 30, -134), (120, 110, 100)), 16)
    hair = union(hair, ellipsoid(q, (0, 106, 2), (34, 30, 32)), 16)
    above = z - 6 + 0.25 * (y + 20)
    parting = np.arctan2(x, above)
    waves = np.sin(24 * parting + 1.8 * np.sin(0.07 * y + 2 * parting))
    waves = waves * np.clip(2 * parting, 0, 1) * np.clip((np.hypot(x, above) - 30) / 20, 0, 1)
    band = np.exp(-(((y + 0.5 * z - 10) / 8) ** 2))
    hair = hair + 3.2 * waves * (1 - band) - 1.5 * band
    d = union(_whole_face(q), hair, 4)
    d = cut(d, p[2] + 140 + 0.2 * p[1] + 3 * weathering(p, 60, 4), 14)
    chips = union(ellipsoid(p, (46, -84, 78), (16, 12, 12)), ellipsoid(p, (-90, 18, -34), (12, 15, 12)), 1)
    return cut(d, chips, 5) + 0.3 * weathering(p, 24, 8)

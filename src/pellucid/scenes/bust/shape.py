"""A head with closed eyes as a signed distance: ellipsoids and capsules in smooth union, lines engraved on top.

Millimetres, life size: x to its left, y to the back, z up; the origin lies between the ears at the height of the eyes.
"""

from __future__ import annotations

import numpy as np

from ..shapes.distance import Floats, capsule, column, cut, ellipsoid, mirrored, union

LOW, HIGH = np.array([-150.0, -135.0, -232.0]), np.array([150.0, 150.0, 150.0])
BASE = -222.0

# The line where the lids of an eye meet, and that between the lips: height over the distance from the middle.
EYE_X, EYE_Z, LID_WIDTH = 31.0, -7.0, 14.5
MOUTH_Z, MOUTH_WIDTH = -71.0, 25.0
KNOT = (0.0, 92.0, 62.0)


def lid_line(x: Floats) -> Floats:
    """Height of the line where the lids of an eye meet at ``|x|``."""
    t = (x - EYE_X) / LID_WIDTH
    return EYE_Z - 5.0 * (1 - t * t) + 1.2 * t


def mouth_line(x: Floats) -> Floats:
    """Height of the line between the lips at ``|x|``."""
    t = x / MOUTH_WIDTH
    return MOUTH_Z - 1.6 * np.exp(-((t / 0.22) ** 2)) + 1.8 * t**4


def strands(p: Floats) -> Floats:
    """Phase [rad] across the strands of hair, that run from the forehead around the skull into the knot."""
    x, y, z = p
    angle = np.arctan2(np.abs(x), z - 18 + 0.10 * (y - 60))
    wave = 0.22 * np.sin(0.055 * y + 1.5 * np.sin(0.02 * z))
    return 30 * (angle + wave * np.minimum(angle, 1))


def _head(p: Floats, m: Floats) -> Floats:
    """Skull, jaw, cheeks, brow, neck and shoulders; ``m`` is ``p`` with |x|."""
    d = ellipsoid(p, (0, 14, 32), (72, 92, 80))
    d = union(d, ellipsoid(p, (0, -34, -28), (58, 51, 80)), 24)
    d = union(d, capsule(m, (8, -66, -94), (44, -6, -62), 15, 13), 26)
    d = union(d, ellipsoid(p, (0, -74, -96), (19, 17, 15)), 16)
    d = union(d, ellipsoid(m, (36, -52, -36), (26, 27, 27)), 22)
    d = union(d, capsule(m, (12, -81, 16), (46, -67, 18), 9, 6), 22)
    neck = capsule(p, (0, 24, -60), (0, 36, -190), 44, 50)
    neck = union(neck, capsule(m, (42, 26, -66), (12, -16, -186), 7, 7), 24)
    d = union(d, neck, 16)
    chest = ellipsoid(p, (0, 40, -226), (122, 66, 50))
    chest = union(chest, capsule(m, (10, -14, -190), (76, 20, -192), 6, 5), 20)
    return union(d, chest, 40)


def _features(d: Floats, p: Floats, m: Floats) -> Floats:
    """Eyes, nose, mouth and ears."""
    d = cut(d, ellipsoid(m, (29, -95, -3), (18, 15, 13)), 12)
    d = union(d, ellipsoid(m, (EYE_X, -67, -4), (17.5, 17, 15)), 4)
    nose = capsule(p, (0, -83, 14), (0, -99, -36), 6.5, 8.0)
    nose = union(nose, ellipsoid(p, (0, -101, -40), (9.5, 9.5, 8.5)), 8)
    nose = union(nose, ellipsoid(m, (11, -92, -43), (7, 9, 6.5)), 6)
    d = union(d, nose, 10)
    d = cut(d, ellipsoid(m, (6, -97, -50.5), (3.4, 5, 3)), 3)
    d = union(d, ellipsoid(p, (0, -70, -70), (32, 21, 25)), 18)
    upper = capsule(m, (5, -90.5, -66.5), (23, -79.5, -71.5), 5.0, 2.2)
    lower = capsule(m, (0, -88.5, -77), (20, -80, -73), 6.8, 2.8)
    d = union(d, union(upper, lower, 0.6), 3.5)
    q = _ear_coordinates(m)
    ear = ellipsoid(q, (0, 0, 0), (6.5, 18, 29))
    ear = cut(ear, ellipsoid(q, (6.5, -2, 4), (5.5, 11.5, 20)), 4)
    ear = union(ear, capsule(q, (2, 5, 14), (2, 3, -8), 2.0, 2.6), 4)
    ear = union(ear, ellipsoid(q, (2, -12, -3), (5, 5, 7)), 4)
    return union(d, ear, 5)


def _ear_coordinates(m: Floats) -> Floats:
    """Coordinates of an ear, tilted back by 12 degrees and turned out by 22."""
    x, y, z = m - column((73, 16, -14))
    c, s = np.float32(np.cos(0.21)), np.float32(np.sin(0.21))
    y, z = c * y - s * z, s * y + c * z
    c, s = np.float32(np.cos(0.38)), np.float32(np.sin(0.38))
    return np.stack([c * x - s * y, s * x + c * y, z])


def hair_distance(p: Floats) -> Floats:
    """Distance to the hair: a cap over the skull with a window for the face, and a knot behind."""
    m = mirrored(p)
    cap = ellipsoid(p, (0, 17, 36), (79, 96, 82))
    cap = cut(cap, ellipsoid(p, (0, -84, -24), (66, 74, 92)), 10)
    cap = cut(cap, ellipsoid(m, (84, 6, -40), (40, 34, 52)), 8)
    cap = cut(cap, ellipsoid(p, (0, 60, -130), (110, 90, 92)), 14)
    return union(cap, ellipsoid(p, KNOT, (36, 30, 32)), 9)


def face_distance(p: Floats) -> Floats:
    """Distance to the head without its hair, on neck and shoulders that go on below the base."""
    m = mirrored(p)
    x, y, z = m
    d = _features(_head(p, m), p, m)
    front = 1 / (1 + np.exp(np.clip((y + 58) / 4, -30, 30)))
    lash = np.exp(-(((z - lid_line(x)) / 1.3) ** 2)) * np.exp(-((np.abs(x - EYE_X) / LID_WIDTH) ** 8))
    fold = np.exp(-(((z - 9.5 - 0.6 * lid_line(x)) / 1.5) ** 2)) * np.exp(-((np.abs(x - EYE_X) / LID_WIDTH) ** 6))
    lips = np.exp(-(((z - mouth_line(x)) / 1.5) ** 2)) * np.exp(-((x / MOUTH_WIDTH) ** 10))
    philtrum = np.exp(-((x / 2.6) ** 2) - ((z + 57) / 5.5) ** 2)
    return d + front * (1.3 * lash + 0.7 * fold + 1.8 * lips + 1.1 * philtrum)


def bust_distance(p: Floats) -> Floats:
    """Distance [mm] to the bust at ``p`` (3, n), negative inside: (n,)."""
    hair = hair_distance(p)
    # The strands come together at the knot, where they would be finer than the mesh.
    depth = 1.2 / (1 + np.exp((p[1] - 88) / 5))
    d = union(face_distance(p), hair + depth * (1 - np.abs(np.sin(0.5 * strands(p)))) ** 2 - 0.4, 2.0)
    return cut(d, p[2] - BASE, 3.0)

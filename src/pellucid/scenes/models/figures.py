"""Two whole figures as signed distances: a dinosaur with a long neck, and a wanderer in a robe. Millimetres; z is up."""

from __future__ import annotations

import numpy as np

from ..shapes.distance import Floats, about, capsule, cut, disc, ellipsoid, mirrored, tube, union


def longneck(p: Floats) -> Floats:
    """Distance to a dinosaur with a crest that strides towards +x: neck, tail and crest are thin, its trunk is not."""
    neck = tube(p, [(70, 0, 52), (124, 0, 78), (156, 4, 132), (164, 8, 200)], (38, 26, 16, 14))
    tail = tube(p, [(-50, 0, 52), (-118, 4, 44), (-186, 18, 22), (-246, 34, 26), (-292, 34, 52)], (38, 27, 16, 8, 3))
    trunk = union(ellipsoid(p, (34, 0, 50), (78, 46, 48)), ellipsoid(p, (-42, 0, 52), (70, 46, 48)), 30)
    d = union(union(trunk, neck, 18), tail, 18)
    q = about(p, (166, 8, 212), 0.22)
    head = tube(q, [(-2, 0, 0), (28, 0, 0), (62, 0, -12)], (21, 18, 13))
    head = union(head, tube(q, [(0, 0, 10), (-30, 0, 26), (-70, 0, 24)], (13, 9, 5)), 9)
    head = union(head, ellipsoid(np.stack([q[0], np.sqrt(q[1] ** 2 + 9), q[2]]), (16, 15, 6), (6, 5, 5.5)), 3)
    mouth = np.exp(-(((q[2] + 9 + 0.22 * (q[0] - 30)) / 2.2) ** 2)) / (1 + np.exp(np.clip(-(q[0] - 24) / 3, -30, 30)))
    d = union(d, head + 1.6 * mouth, 10)
    for x, y, forwards, size in ((56, 27, 24, 0.95), (56, -27, -16, 0.95), (-52, 30, -6, 1.12), (-52, -30, -44, 1.12)):
        ankle = (x + forwards, 1.25 * y, -66)
        leg = tube(p, [(x, y, 40), (x + 0.5 * forwards + 8, 1.3 * y, -20), ankle], (30 * size, 19 * size, 14 * size))
        foot = ellipsoid(p, np.add(ankle, (7, 0, -16)), (24 * size, 18 * size, 14))
        for turn in (-12, 0, 12):
            toe = np.add(ankle, ((26 - 0.3 * abs(turn)) * size, turn, -21))
            foot = union(foot, ellipsoid(p, toe, (9, 6.5, 8)), 2)
        d = union(d, union(leg, foot, 12), 16)
    return cut(d, p[2] + 90, 6)


def wanderer(p: Floats) -> Floats:
    """Distance to a bearded old man in a hooded robe, with a sack on his back and a staff; he looks along -y."""
    x, y, z = p
    m = mirrored(p)
    angle = np.arctan2(x, -y)
    folds = np.clip((70 - z) / 170, 0, 1) * (np.sin(9 * angle + 0.012 * z) + 0.5 * np.sin(14 * angle + 1.4))
    robe = tube(p, [(0, 4, 96), (0, 2, 16), (0, 0, -70)], (42, 52, 72)) + 3.0 * folds
    d = union(robe, capsule(m, (12, 8, 98), (42, 8, 84), 34, 26), 22)
    belt = (z - 8 + 3 * np.sin(angle)) / 7
    d = d + 2.5 * np.exp(-((belt / 1.6) ** 4)) - 5.0 * np.exp(-((belt / 0.9) ** 4))
    hood = union(ellipsoid(p, (0, 4, 150), (43, 47, 51)), capsule(p, (0, 30, 172), (0, 60, 140), 24, 9), 20)
    hood = cut(hood, ellipsoid(p, (0, -52, 142), (30, 40, 40)), 10)
    d = union(d, union(hood, _face(p, m), 3), 8)
    sleeve = tube(m, [(54, 4, 82), (68, -26, 44), (36, -62, 38)], (26, 24, 22))
    sleeve = sleeve + 1.8 * np.sin(0.2 * (m[2] + m[1] - 0.6 * m[0]))
    sleeve = cut(sleeve, capsule(m, (30, -70, 38), (10, -92, 38), 13, 15), 8)
    hand = union(capsule(m, (44, -52, 38), (15, -78, 40), 10, 9), ellipsoid(m, (11, -84, 42), (12, 10, 12)), 6)
    d = union(d, union(sleeve, hand, 5), 8)
    staff = tube(p, [(16, -96, -104), (2, -90, 0), (-18, -85, 100), (-38, -82, 168)], (7.5, 7, 7.5, 8))
    staff = union(staff, ellipsoid(p, (-40, -81, 176), (13, 13, 14)), 8)
    sack = union(ellipsoid(p, (6, 62, 66), (50, 38, 52)), capsule(p, (0, 44, 110), (-14, 14, 122), 14, 10), 16)
    sack = sack + 1.6 * np.sin(0.12 * z + 0.09 * x + np.sin(0.1 * x))
    d = union(union(d, sack, 10), staff, 5)
    return union(cut(d, z + 104, 4), disc(p, (0, -8, -108), 106, 16, 8), 8)


def _face(p: Floats, m: Floats) -> Floats:
    """Distance to the wanderer's face and beard; ``m`` is ``p`` with |x|."""
    x, _, z = p
    d = ellipsoid(p, (0, -14, 146), (28, 28, 33))
    d = union(d, capsule(m, (5, -40, 160), (17, -33, 159), 4.5, 4), 6)
    d = union(d, capsule(p, (0, -40, 154), (0, -50, 141), 4.5, 6.5), 6)
    d = cut(d, ellipsoid(m, (12, -45, 150), (7, 6, 5)), 5)
    d = union(d, ellipsoid(m, (12, -34, 150), (6, 5, 4.5)), 2)
    d = union(d, ellipsoid(m, (16, -33, 139), (9, 8, 8)), 6)
    beard = tube(p, [(0, -32, 124), (0, -48, 92), (0, -50, 46)], (26, 24, 8))
    beard = beard + 1.8 * np.sin(0.36 * x + 1.6 * np.sin(0.06 * z)) * np.clip((136 - z) / 20, 0, 1)
    return union(d, union(beard, capsule(m, (2, -47, 134), (22, -44, 118), 7, 4), 4), 5)

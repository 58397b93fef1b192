"""Draw an item of a cluster in proportion to its strength."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

ONE_MINUS_EPSILON = 1 - 2.0**-24


@dr.syntax
def draw(strength: mi.Float, leaves: mi.UInt32, node: mi.UInt32, u: mi.Float, active: mi.Bool = True) -> mi.UInt32:
    """Walk down a binary tree from a node, at every branch by the share of the strengths below.

    Parameters
    ----------
    strength : Float
        Summed strength of every node.
    leaves : UInt32
        Number of leaves, opaque.
    u : Float
        Random numbers, stretched at every branch: evenly spaced ones draw items that are spread evenly over the cluster.

    Returns
    -------
    UInt32
        Numbers of leaves, from 0 on.
    """
    node, u = mi.UInt32(node), mi.Float(u)
    total = dr.gather(mi.Float, strength, node, active)
    while dr.hint((node < leaves) & active, label="pellucid draw"):
        node = node << 1
        left = dr.gather(mi.Float, strength, node)
        share = left / total
        is_right = u >= share
        u = dr.select(is_right, (u - share) / (1 - share), u / share)
        u = dr.clip(u, 0, ONE_MINUS_EPSILON)
        node = dr.select(is_right, node + 1, node)
        total = dr.select(is_right, dr.gather(mi.Float, strength, node), left)
    return node - leaves

"""Textures of the reflectance that belong to the shape: colours of vertices, attributes of a mesh."""

import mitsuba as mi
import numpy as np
import pytest
import trimesh

from pellucid.scene.meshes.buffers import mesh_from_arrays
from worlds.balls import looking_at, scene, translucent

BLUE, RED = (0.1, 0.1, 0.8), (0.8, 0.1, 0.1)


def half_and_half(**more):
    """A ball, blue towards -x and red towards +x."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=20.0)
    colors = np.where(ball.vertices[:, :1] < 0, BLUE, RED)
    texture = {"type": "mesh_attribute", "name": "vertex_color"}
    bsdf = translucent(reflectance=texture, dmfp=1.0, eta=1.0, alpha=0.0, **more)
    return mesh_from_arrays("ball", ball.vertices, ball.faces, ball.vertex_normals, bsdf=bsdf, colors=colors)


@pytest.mark.parametrize(
    "method, settings",
    [
        ("two_pass", {"sample_count": 20000}),
        ("exact", {"sample_count": 20000}),
        ("sampled", {}),
        ("texture_space", {"resolution": 256}),
        ("single_pass", {"sample_count": 20000}),
    ],
)
def test_vertex_colours_are_met(method, settings):
    """Under a sky of 1 each half has its own colour, and the border is blurred: neither grey nor black."""
    lit = scene(half_and_half(), sensor=looking_at([0, 0, 0], [0, 0, 400], fov=5, size=32))
    integrator = mi.load_dict({"type": f"pellucid_{method}", "max_depth": 2, **settings})
    image = np.array(mi.render(lit, integrator=integrator, spp=64 if method == "sampled" else 16), float)[..., :3]
    left, right = image[14:18, 6:9].mean(axis=(0, 1)), image[14:18, 23:26].mean(axis=(0, 1))
    assert left == pytest.approx(BLUE, rel=0.06)
    assert right == pytest.approx(RED, rel=0.06)
    middle = image[14:18, 15:17].mean(axis=(0, 1))
    assert 0.2 < middle[0] < 0.7 and 0.2 < middle[2] < 0.7


def test_the_medium_is_that_of_the_mean_colour():
    from pellucid.methods.preparation import open_scene

    body = open_scene(scene(half_and_half(scale=2.0))).bodies[0].body
    assert body.medium.total_diffuse_reflectance == pytest.approx([0.45, 0.1, 0.45], abs=0.02)
    assert body.medium.dmfp == pytest.approx(0.5)

"""Figure 2 of Arbree, Walter and Bala 2008: where on the teapot the light of a picture is measured.

    python benchmarks/single_pass_figure2.py

writes docs/figures/single_pass_figure2.png and .json: a dot for every cluster of irradiance samples that some eye point of the
picture asks for, from the camera and from the other side; red where the eye sees it at once, blue where only other surfaces do.
Takes half a minute on two cores; ``--quick`` makes a small picture and writes nothing.
"""

from __future__ import annotations

import argparse
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.methods.single_pass.adaptive.traversal import walk, walk_source
from pellucid.methods.single_pass.modes import CUT_ERROR
from support.images import save_row
from support.record import FIGURES, save
from support.scenes import load, published
from support.single_pass import PUBLISHED, Seen, at_once, take_picture

COMMAND = "python benchmarks/single_pass_figure2.py"
NAME = "single_pass_figure2"
TURN = 130.0
"""The second view is turned by so much [degrees]."""
RED, BLUE = np.array([0.85, 0.02, 0.02]), np.array([0.05, 0.2, 0.85])


def asked_for(seen: Seen) -> np.ndarray:
    """Find the nodes of all cuts that some eye point of the picture asks for."""
    samples = seen.body.samples
    marks = dr.zeros(mi.UInt32, 2 * samples.leaves)

    def visit(nothing: Any, node: Any, weight: Any, r2: Any, accepted: Any) -> Any:
        dr.scatter(marks, mi.UInt32(1), node, accepted)
        return nothing

    walk(walk_source(samples, seen.body.table, CUT_ERROR), seen.eyes.p, (), visit)
    dr.eval(marks)
    return np.flatnonzero(marks.numpy()).astype(np.int64)


def middles(seen: Seen, node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the sample next to the centroid of each cluster, for that is on the surface: positions and normals."""
    samples = seen.body.samples
    first, last = samples.members(node)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(samples.p.astype(float), axis=0)])
    centroid = (sums[last] - sums[first]) / (last - first)[:, None]
    leaf = np.empty(len(node), np.int64)
    for k, (a, b) in enumerate(zip(first, last, strict=True)):
        leaf[k] = a + (np.argmin(np.sum((samples.p[a:b] - centroid[k]) ** 2, axis=1)) if b - a > 1 else 0)
    si = samples.receiver(mi.UInt32(leaf.astype(np.uint32)), seen.body.placement, dr.zeros(mi.UInt32, len(leaf)))
    return si.p.numpy().T, si.n.numpy().T


def shaded(scene: Any, points: list[tuple[np.ndarray, np.ndarray]], reach: float) -> np.ndarray:
    """Draw the body grey, lit from the camera, and the points of two lists that are not hidden, blue and red."""
    sensor = scene.sensors()[0]
    width, height = sensor.film().size()
    y, x = np.mgrid[:height, :width] + 0.5
    place = mi.Point2f(np.float32(x.ravel() / width), np.float32(y.ravel() / height))
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    facing = np.abs(dr.dot(si.sh_frame.n, ray.d).numpy())
    grey = np.where(si.is_valid().numpy(), 0.12 + 0.45 * facing, 1.0)
    picture = np.repeat(grey.reshape(height, width, 1), 3, axis=2)
    for colour, (p, n) in zip((BLUE, RED), points, strict=True):
        rows, columns = on_film(scene, sensor, p, n, reach)
        for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
            picture[np.clip(rows + down, 0, height - 1), np.clip(columns + right, 0, width - 1)] = colour
    return picture


def on_film(scene: Any, sensor: Any, p: np.ndarray, n: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the pixels, rows and columns, of the points that nothing hides."""
    eye = np.array(sensor.world_transform().translation()).ravel()
    # A little above the surface, so that the facets of the mesh hide no point.
    start = p + 2e-3 * reach * n
    away = eye - start
    distance = np.linalg.norm(away, axis=1)
    ray = mi.Ray3f(
        mi.Point3f(start.T.astype(np.float32)),
        mi.Vector3f((away / distance[:, None]).T.astype(np.float32)),
        mi.Float(distance.astype(np.float32)),
        0.0,
        mi.Color0f(),
    )
    shown = ~scene.ray_test(ray).numpy() & (np.sum(n * away, axis=1) > 0)
    point = dr.zeros(mi.Interaction3f, int(shown.sum()))
    point.p = mi.Point3f(p[shown].T.astype(np.float32))
    found, weight = sensor.sample_direction(point, mi.Point2f(0.5))
    inside = weight.numpy()[0] > 0
    columns, rows = np.floor(found.uv.numpy()[:, inside]).astype(int)
    return rows, columns


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small, to see that it runs; writes nothing")
    quick = parser.parse_args().quick
    resolution, options = ((160, 120), {"size": 60.0, "detail": 6}) if quick else ((640, 480), {})
    method = {**PUBLISHED, "direct": 64, "indirect": 64}
    picture = take_picture(
        published("teapot_table", resolution=resolution, integrator=method, **options), 1, warm=False
    )
    (seen,) = picture.seen
    node, direct = asked_for(seen), asked_for(at_once(picture.seen)[0])
    points = [middles(seen, which) for which in (np.setdiff1d(node, direct), direct)]
    samples = seen.body.samples
    print(f"{len(node):,} clusters of {samples.count:,} samples, {len(direct):,} of them seen at once")
    size = 2 * resolution[0], 2 * resolution[1]
    pictures = []
    for caption, turn in (("from the camera", 0.0), (f"turned by {TURN:.0f} degrees", TURN)):
        spec = published("teapot_table", resolution=size, camera_angle=turn, **options)
        spec = {key: value for key, value in spec.items() if key in ("type", "sensor", "teapot")}
        picture = shaded(load(spec), points, float(np.ptp(samples.p, axis=0).max()))
        # Two pixels to one, and only where the teapot is.
        picture = picture.reshape(resolution[1], 2, resolution[0], 2, 3).mean(axis=(1, 3))
        pictures.append((caption, picture[resolution[1] // 5 : resolution[1] * 9 // 10]))
    if quick:
        return
    save_row(FIGURES / f"{NAME}.png", pictures)
    save(
        NAME,
        COMMAND,
        {
            "clusters": len(node),
            "direct": len(direct),
            "single": int(np.sum(node >= samples.leaves)),
            "samples": samples.count,
        },
    )


if __name__ == "__main__":
    main()

"""How noisy virtual point lights leave the irradiance of the bodies that are seen, in the scenes of the single pass.

    python benchmarks/virtual_lights.py

writes docs/figures/virtual_lights.json and the table of docs/theory/light_samples.md between its marks. Takes three minutes on
two cores; ``--quick`` draws few lights, and writes nothing.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM, which has to come before mitsuba)

# isort: split
import drjit as dr
import mitsuba as mi
import numpy as np

# ruff: noqa: E402
mi.set_variant("llvm_ad_rgb")  # which the modules below are made for

from pellucid.kernels.memory import columns
from pellucid.light.points import virtual as virtual_lights
from pellucid.light.points.discretise import discretise, irradiance_of_all
from pellucid.light.points.emission import Receivers
from pellucid.light.points.records import to_device
from pellucid.scene.bodies import Role, acting_as
from pellucid.scenes.builtin import build
from support.record import DOCS, fill, markdown_table, median, save
from support.single_pass import Picture, take_picture

COMMAND = "python benchmarks/virtual_lights.py"
NAME = "virtual_lights"
SCENES: dict[str, dict[str, Any]] = {
    "teapot_table": {},
    "kitchen": {"samples": 1e5},
    "mezquita": {"samples": 1e5},
}
COUNTS, SEEDS, POINTS, RECEIVERS = (12_500, 50_000), 8, 400, 4096
DEPTH, ETA = 6, 1.5


def points_in_view(picture: Picture, count: int, seed: int) -> Receivers:
    """Draw points, with normals, on the bodies of a picture: the more the more of its eye points are on them."""
    rng = np.random.default_rng(seed)
    share = np.array([len(seen) for seen in picture.seen])
    each = rng.multinomial(count, share / share.sum())
    places, normals = [], []
    for seen, here in zip(picture.seen, each, strict=True):
        leaf = rng.integers(0, seen.body.samples.count, here).astype(np.uint32)
        copy = rng.choice(seen.eyes.copy.numpy(), here)
        si = seen.body.samples.receiver(mi.UInt32(leaf), seen.body.placement, mi.UInt32(copy))
        places.append(si.p.numpy().T)
        normals.append(si.sh_frame.n.numpy().T)
    return np.concatenate(places), np.concatenate(normals)


def lit_by(scene: mi.Scene, lights: Any, points: Receivers) -> np.ndarray:
    """Sum the irradiance of all lights at points: ``(n,)``, the mean of three channels."""
    p, n = points
    si = dr.zeros(mi.SurfaceInteraction3f, len(np.asarray(p)))
    si.p, si.n = mi.Point3f(*columns(p)), mi.Normal3f(*columns(n))
    si.sh_frame = mi.Frame3f(si.n)
    return np.mean(irradiance_of_all(scene, to_device(lights), len(lights), si, ETA)[0].numpy(), axis=0)


def measure(name: str, counts: tuple[int, ...], seeds: int, options: dict[str, Any]) -> list[dict[str, Any]]:
    """Draw the virtual lights of a scene with several seeds, and compare what they send to the same points."""
    method = {"type": "pellucid_single_pass", "direct": 64, "indirect": 64}
    picture = take_picture(build(name, resolution=(96, 72), integrator=method, **options), 1, warm=False)
    receivers, points = points_in_view(picture, RECEIVERS, 0), points_in_view(picture, POINTS, 1)
    photons = [0]
    follow = virtual_lights._follow

    def counted(scene, sampler, ray, *others):
        photons[0] += dr.width(ray)
        return follow(scene, sampler, ray, *others)

    virtual_lights._follow = counted
    rows = []
    try:
        with acting_as(Role.DIFFUSE, [lit.body for lit in picture.state.bodies]):
            for count in counts:
                found, times, drawn, followed = [], [], [], []
                for seed in range(seeds + 1):  # the first compiles
                    photons[0], begin = 0, time.perf_counter()
                    lights = discretise(picture.scene, 64, count, seed, DEPTH, receivers)
                    dr.sync_thread()
                    times.append(time.perf_counter() - begin)
                    lights = lights.take(lights.indirect)
                    drawn.append(len(lights))
                    followed.append(photons[0])
                    found.append(lit_by(picture.scene, lights, points))
                light = np.array(found[1:])
                noise = light.std(axis=0, ddof=1) / np.maximum(light.mean(axis=0), 1e-30)
                rows.append(
                    {
                        "asked": count,
                        "lights": int(np.mean(drawn[1:])),
                        "photons": int(np.mean(followed[1:])),
                        "seconds": median(times[1:]),
                        "noise": float(np.median(noise)),
                        "noise_of_nine_in_ten": float(np.quantile(noise, 0.9)),
                    }
                )
                print(name, rows[-1], flush=True)
    finally:
        virtual_lights._follow = follow
    return rows


def table(results: dict[str, Any]) -> str:
    """Lay out all rows."""
    head = [
        "scene",
        "lights asked for",
        "distinct",
        "photons",
        "time",
        "noise, median",
        "90th percentile",
    ]
    body = [
        [name, f"{row['asked']:,}", f"{row['lights']:,}", f"{row['photons']:,}", f"{row['seconds']:.1f} s",
         f"{row['noise']:.1%}", f"{row['noise_of_nine_in_ten']:.0%}"]
        for name, rows in results.items()
        for row in rows
    ]  # fmt: skip
    return f"`{COMMAND}`\n\n{markdown_table(head, body)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few lights, to see that it runs; writes nothing")
    quick = parser.parse_args().quick
    counts, seeds = ((1000,), 2) if quick else (COUNTS, SEEDS)
    results = {name: measure(name, counts, seeds, options) for name, options in SCENES.items()}
    if not quick:
        save(NAME, COMMAND, results)
        fill(DOCS / "theory" / "light_samples.md", NAME, table(results))


if __name__ == "__main__":
    main()

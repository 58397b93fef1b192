"""Uses everything that is public, as a program with types would; it is checked and not run."""

from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

import pellucid
from pellucid import (
    Camera,
    Cluster,
    Engine,
    Fit,
    Layers,
    Medium,
    PellucidError,
    PellucidWarning,
    Prepared,
    fit,
    load_scene,
    prepare,
    render_layers,
)


def exitance(source: str | Path) -> NDArray[np.float32]:
    scene: mi.Scene = load_scene(source, size=50.0)
    prepared: Prepared = prepare(scene, method="two_pass", max_error=0.01)
    names: list[str] = prepared.bodies
    picture = mi.render(prepared.scene, integrator=prepared.integrator)
    print(names, picture)
    return prepared.exitance([[0, 0, 1]], normals=[[0, 0, 1]], body=names[0])


def denoised(scene: mi.Scene) -> NDArray[np.float32]:
    layers: Layers = render_layers(scene, 0, seed=1, spp=4, integrator=prepare(scene).integrator)
    print(layers.colour, layers.albedo, layers.normal, layers.depth, layers.exitance)
    return layers.denoised


def on_many_machines(source: str | Path) -> NDArray[np.float32]:
    with Cluster("local:2") as cluster:
        frames: list[Path] = cluster.turntable(source, "frames", frames=12)
        print(frames)
        return cluster.render(source, spp=4, denoise=True)


def measured(scene: mi.Scene, photo: NDArray[np.float64]) -> Medium:
    found: Fit = fit(scene, [photo], exposure="shared", spp=4)
    found.write("material.json")
    print(found.standard_deviation, found.condition_number)
    return found.medium


def medium() -> float:
    marble: Medium = Medium.from_preset("marble", scale=2.0)
    grey = Medium.from_reflectance(0.5, [1.0, 2.0, 3.0], eta=1.4, g=0.8)
    own = Medium(sigma_s_prime=[1.0, 1.0, 1.0], sigma_a=0.01, name="own")
    profile: NDArray[np.float64] = marble.diffuse_reflectance(np.linspace(0, 1, 8))
    lengths: list[NDArray[np.float64]] = [m.dmfp for m in (grey, own)]
    return float(profile.sum() + lengths[0].sum() + marble.eta)


def frame(scene: mi.Scene) -> NDArray[np.uint8]:
    engine = Engine(scene, resolution=512)
    engine.settings.samples = 400
    engine.set_light(0, intensity=2.0)
    engine.set_medium(0, engine.bodies[0].medium)
    engine.set_size(20.0)
    print(engine.lights[0].name, engine.notes)
    camera = Camera(origin=[0, 0, 5], target=[0, 0, 0])
    linear: NDArray[np.float32] = engine.linear(camera, (64, 64))
    print(linear.shape)
    return engine.frame(camera, (64, 64), moving=False).pixels


def refused() -> str:
    try:
        return str(medium())
    except PellucidError as error:
        return f"{pellucid.__version__}: {error}"


warning: type[UserWarning] = PellucidWarning

"""Render the pictures of the gallery and of the page of failures.

    python benchmarks/figures.py
    python benchmarks/figures.py --only figure4

writes PNGs to docs/gallery/. Takes about six minutes on two cores for all of them; ``--quick`` makes small, noisy
ones in a temporary folder.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pellucid  # points Dr.Jit at its LLVM, which has to come before mitsuba

# isort: split
import mitsuba as mi
import numpy as np

from pellucid.cli import sample_picture
from pellucid.model.medium import Medium
from pellucid.scenes.builtin import build
from pellucid.scenes.stage import PictureSettings, diffuse, lamp, rgb, start, sweep
from single_pass_table import COARSE, FEW
from support.environment import environment
from support.film import film
from support.images import enlarged, save_animation, save_jpeg, save_png, save_row, save_rows
from support.record import DOCS
from support.scenes import independent, load, published
from support.volume import as_volume, volume_path_tracer

WIDE, LARGE = (768, 576), (1280, 960)
MATERIALS = ("marble", "skin1", "wholemilk", "ketchup", "apple", "potato")
MODELS = (
    ("sphere", "marble", 60.0),
    ("horned_head", "skin2", 60.0),
    ("relief_head", "apple", 60.0),
    ("philosopher", "marble", 60.0),
    ("longneck", "potato", 60.0),
    ("antique_head", "wholemilk", 60.0),
    ("wanderer", "cream", 60.0),
    ("horned_head", "marble", 150.0),
)
"""Model, material, and where the lamp stands."""

MODEL_SIZE = 20.0
ROOM = "lebombo_1k"
SCENES = ("teapot_table", "kitchen", "mezquita")
CLOSE_UPS = {"teapot_table": (0.3, 0.5), "kitchen": (0.4, 0.4), "mezquita": (0.4, 0.3)}
"""Left upper corner of the part that is shown pixel by pixel, in the size of the picture."""

QUICK = {"type": "pellucid_single_pass", **FEW}
CAPITALS = ((13.6, 26.0, 2.2), (15.3, 30.0, 3.2))
"""Eye and target in the Mezquita [m]."""

SMOOTH_MARBLE = {"type": "pellucid_translucent", "material": "marble", "alpha": 0.0}
THICKNESSES = (0.5, 1.0, 2.0, 4.0, 8.0)  # [mm]


@dataclass
class Room:
    """Where pictures go, and how good they become."""

    folder: Path
    quick: bool
    temporary: Path

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Take a quarter of a resolution for a quick look."""
        return (width // 4, height // 4) if self.quick else (width, height)

    def shoot(self, spec: dict[str, Any], spp: int, method: str | None = None, **settings: Any) -> np.ndarray:
        """Render a scene dictionary by one of our methods, or by the integrator it names."""
        scene = load(independent(spec))
        if self.quick and method == "two_pass":
            settings |= {"sample_count": 4000, "sampling": "uniform", "irradiance_paths": 8}
        integrator = mi.load_dict({"type": f"pellucid_{method}", **settings}) if method else scene.integrator()
        return np.array(integrator.render(scene, 0, 1, 4 if self.quick else spp))[..., :3]

    def of_awb08(self, name: str) -> dict[str, Any]:
        """Describe a scene of AWB08, large, with its own integrator."""
        quick = COARSE[name] | {"integrator": QUICK} if self.quick else {}
        return published(name, resolution=self.size(*LARGE), **quick)

    def denoised(self, spec: dict[str, Any]) -> np.ndarray:
        """Render a scene dictionary as the command line does, with 16 samples a pixel."""
        return pellucid.render_layers(load(independent(spec)), spp=16).denoised

    def volume(self, spec: dict[str, Any], keys: list[str], medium: Medium, spp: int) -> np.ndarray:
        """Render a scene dictionary with shapes turned into volumes."""
        for key in keys:
            spec = as_volume(spec, key, medium, self.temporary)
        return np.array(volume_path_tracer().render(load(independent(spec)), 0, 1, 4 if self.quick else spp))

    def save(self, name: str, picture: np.ndarray) -> Path:
        """Write a picture of the gallery."""
        return save_png(self.folder / f"{name}.png", picture)


# ------------------------------------------------------------------ figures of the paper


def figure3(room: Room) -> list[Path]:
    """The marble teapot: sampled, hierarchical, under the sky, and its surface samples."""
    small = published("teapot", resolution=room.size(512, 384))
    spec, sky = (published(name, resolution=room.size(*WIDE)) for name in ("teapot", "teapot_env"))
    scene = load(spec)
    prepared = pellucid.prepare(scene, "two_pass").integrator.prepared
    hits = sample_picture.look(scene, scene.sensors()[0], prepared.lookup)
    dots = sample_picture.dot_picture(scene, scene.sensors()[0], hits, prepared.bodies)
    return [
        room.save("figure3_sampled", room.shoot(small, 64, "sampled")),
        room.save("figure3_hierarchical", room.shoot(spec, 64, "two_pass", irradiance_paths=64)),
        room.save("figure3_environment", room.shoot(sky, 128, "two_pass", irradiance_paths=64)),
        room.save("figure3_samples", dots),
    ]


def figure4(room: Room) -> list[Path]:
    """The Cornell box with a translucent box: colours bleed both ways."""
    spec = published("cornell_box", resolution=room.size(640, 640))
    return [room.save("figure4_cornell_box", room.shoot(spec, 192, "two_pass", irradiance_paths=128))]


def figure5(room: Room) -> list[Path]:
    """A short film of a translucent character."""
    frames = 4 if room.quick else 36
    path = room.folder / "figure5_film.webp"
    return [film(lambda spec: room.shoot(spec, 24, "two_pass", irradiance_paths=64), frames, room.size(320, 240), path)]


def environments(room: Room) -> list[Path]:
    """The glossy teapot in a room that was photographed with all its brightness, exposed for the teapot."""
    spec = published("teapot_env", resolution=room.size(640, 480), environment=environment(ROOM, room.temporary))
    return [room.save("environment_room", 0.6 * room.shoot(spec, 32, "two_pass", irradiance_paths=64))]


def figure6(room: Room) -> list[Path]:
    """A textured bust, with and without the light that travels inside."""
    spec = published("bust", resolution=room.size(512, 640))
    with_light = room.shoot(spec, 64, "two_pass", irradiance_paths=64)
    without = room.shoot({**spec, "integrator": {"type": "path", "max_depth": 6}}, 96)
    pictures = [("diffuse", without), ("translucent", with_light)]
    return [save_row(room.folder / "figure6_bust.png", pictures)]


def materials(room: Room) -> list[Path]:
    """Six of the measured materials on one sheet."""
    pictures = []
    for material in MATERIALS:
        bsdf = {"type": "pellucid_translucent", "material": material}
        spec = build("teapot", resolution=room.size(340, 255), bsdf=bsdf)
        pictures.append((material, room.shoot(spec, 64, "two_pass", irradiance_paths=64)))
    return [save_rows(room.folder / "materials.png", [pictures[:3], pictures[3:]])]


def models(room: Room) -> list[Path]:
    """The seven models of the texture-space method, each in another material."""
    pictures = []
    for name, material, light_angle in MODELS:
        bsdf = {"type": "pellucid_translucent", "material": material, "alpha": 0.2}
        spec = build(name, resolution=room.size(288, 288), bsdf=bsdf, size=MODEL_SIZE, light_angle=light_angle)
        pictures.append((f"{name}, {material}", room.shoot(spec, 64, "two_pass", irradiance_depth=2)))
    return [save_rows(room.folder / "models.png", [pictures[:4], pictures[4:]])]


def fit(room: Room) -> list[Path]:
    """How a fit goes from something grey to the wax of three photographs, medium by medium."""
    from pellucid.fitting.medium_fit import fit_medium
    from pellucid.fitting.views import Views
    from pellucid.methods.material import REFLECTANCE

    history: list[tuple[Medium, list[np.ndarray]]] = []

    class RecordedViews(Views):
        def render(self) -> list[np.ndarray]:
            pictures = super().render()
            history.append((self.body.bsdf.medium, pictures))
            return pictures

    def scene(bsdf: dict[str, Any]) -> Any:
        built = [
            build(
                "antique_head",
                resolution=room.size(160, 160),
                bsdf=bsdf,
                size=2 * MODEL_SIZE,
                light_angle=60.0,
                camera_angle=angle,
            )
            for angle in (-50.0, 0.0, 50.0)
        ]
        return load(built[0] | {"sensor_1": built[1]["sensor"], "sensor_2": built[2]["sensor"]})

    surface = {"type": "pellucid_translucent", "alpha": 0.2, "eta": 1.4}
    wax = scene(surface | {"reflectance": rgb(0.8, 0.55, 0.25), "dmfp": rgb(4.0, 2.0, 1.0)})
    settings = {"sample_count": 2000 if room.quick else 12000, "irradiance_paths": 32}
    integrator: Any = mi.load_dict({"type": "pellucid_two_pass", "seed": 9, **settings})
    integrator.prepared = integrator.prepare_scene(wax)
    photos = [mi.render(wax, sensor=k, integrator=integrator, spp=16, seed=50 + k).numpy() for k in range(3)]
    begin = scene(surface | {"reflectance": rgb(0.6, 0.6, 0.6), "dmfp": rgb(1.5, 1.5, 1.5)})
    views = RecordedViews(begin, photos, None, False, 4, settings)
    fit_medium(views, REFLECTANCE, "known", 12)
    frames = []
    for number, (medium, pictures) in enumerate(history):
        reflectance, dmfp = medium.total_diffuse_reflectance, medium.dmfp
        captions = (
            f"medium {number}",
            "R_d " + ", ".join(f"{v:.2f}" for v in reflectance),
            "dmfp " + ", ".join(f"{v:.1f}" for v in dmfp) + " mm",
        )
        frames.append(
            [list(zip(("photographs", "", ""), photos, strict=True)), list(zip(captions, pictures, strict=True))]
        )
    return [save_animation(room.folder / "fit.webp", frames, 600)]


def lengths(room: Room) -> list[Path]:
    """Bodies whose mean free path is a texture, in the shadows of bars: a block by a ramp, a ball by fields."""

    def picture(shape: dict[str, Any], texels: np.ndarray) -> np.ndarray:
        place = mi.ScalarTransform4f()
        spec = start(PictureSettings(room.size(512, 384)), (0, -130, 150), (0, 0, 0), fov=15.0)
        bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(texels.astype(np.float32)[..., None]), "raw": True}
        dmfp = {"dmfp": bitmap | {"filter_type": "nearest"}, "dmfp_scale": rgb(1.0, 0.6, 0.4)}
        surface = {"type": "pellucid_translucent", "reflectance": rgb(0.85, 0.65, 0.45), "alpha": 0.3}
        spec["body"] = shape | {"bsdf": surface | dmfp}
        for k in range(5):  # above the picture
            to_world = place.translate([0, 53.8 + 5 * (k - 2), 100]).scale([80, 0.95, 0.1])
            spec[f"bar{k}"] = {"type": "cube", "to_world": to_world, "bsdf": diffuse(0.02)}
        spec["lamp"] = lamp((0, 140, 260), (0, 0, 0), 1.5, (140000, 132000, 124000))
        spec["sky"] = {"type": "constant", "radiance": rgb(0.04, 0.045, 0.05)}
        return room.shoot(spec, 64, "two_pass", irradiance_paths=64)

    place = mi.ScalarTransform4f()
    block = {"type": "cube", "to_world": place.translate([0, 0, -6]).scale([25, 15, 6])}
    ball = {"type": "sphere", "radius": 16.0}
    ramp, fields = np.geomspace(0.8, 8.0, 256)[:, None], np.where(np.indices((6, 12)).sum(axis=0) % 2, 0.8, 6.0)
    pictures = [
        ("0.8 mm on the left, 8 mm on the right", picture(block, ramp)),
        ("fields of 0.8 mm and of 6 mm", picture(ball, fields)),
    ]
    return [save_row(room.folder / "lengths.png", pictures)]


# ------------------------------------------------------------------ the scenes of AWB08


def single_pass(room: Room) -> list[Path]:
    """The three scenes of AWB08 as the command line renders them, and a close-up of each."""
    return [path for name in SCENES for path in as_rendered(room, name)]


def as_rendered(room: Room, name: str) -> list[Path]:
    """A built-in scene by its own integrator with 16 samples a pixel, denoised; and its middle, pixel by pixel."""
    began = time.perf_counter()
    picture = room.denoised(room.of_awb08(name))
    print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)
    height, width, _ = picture.shape
    x, y = int(CLOSE_UPS[name][0] * width), int(CLOSE_UPS[name][1] * height)
    part = picture[y : y + height // 3, x : x + width // 3]
    return [
        save_jpeg(room.folder / f"single_pass_{name}.jpg", picture),
        save_jpeg(room.folder / f"single_pass_{name}_part.jpg", part),
    ]


def capitals(room: Room) -> list[Path]:
    """Figure 6 of AWB08: capitals of the Mezquita from near by."""
    spec, (eye, target) = room.of_awb08("mezquita"), CAPITALS
    spec["sensor"] = start(PictureSettings(room.size(*LARGE)), eye, target, 40.0, "x")["sensor"]
    return [save_jpeg(room.folder / "single_pass_capitals.jpg", room.denoised(spec))]


def cuts(room: Room) -> list[Path]:
    """The teapot on its table by the paper's cuts, by the adaptive mode and by the paper's reference."""
    spec = published("teapot_table", resolution=room.size(320, 240), **(COARSE["teapot_table"] if room.quick else {}))
    modes = {"cut": "cut", "adaptive": "adaptive", "two_pass": "reference"}
    few = FEW if room.quick else {}
    pictures = [(label, room.shoot(spec, 16, "single_pass", mode=mode, **few)) for mode, label in modes.items()]
    return [save_row(room.folder / "single_pass_modes.png", pictures)]


# ------------------------------------------------------------------ where the model fails


def thin(room: Room) -> list[Path]:
    """A row of marble slabs of growing thickness, lit from behind; the profile takes each for a half space."""
    place = mi.ScalarTransform4f()
    spec = start(PictureSettings(room.size(256, 96)), (0, -300, 20), (0, 0, 20), fov=9.0)
    pitch, width = 18.0, 14.0
    edges = [(k - len(THICKNESSES) / 2) * pitch for k in range(len(THICKNESSES) + 1)]
    keys = []
    for k, thickness in enumerate(THICKNESSES):
        keys.append(f"slab{k}")
        to_world = place.translate([edges[k] + pitch / 2, 0, 20]).scale([width / 2, thickness / 2, 19])
        spec[keys[-1]] = {"type": "cube", "to_world": to_world, "bsdf": SMOOTH_MARBLE}
    for k, x in enumerate(edges):
        to_world = place.translate([x, 0, 20]).scale([(pitch - width) / 2 - 0.01, 6, 19])
        spec[f"divider{k}"] = {"type": "cube", "to_world": to_world, "bsdf": diffuse(0.02)}
    frame = {"top": (0, 60, 120, 21), "bottom": (0, -20, 120, 21), "left": (-67, 20, 20, 19), "right": (67, 20, 20, 19)}
    for name, (x, z, half_width, half_height) in frame.items():
        to_world = place.translate([x, 0, z]).scale([half_width, 6.05, half_height])
        spec[name] = {"type": "cube", "to_world": to_world, "bsdf": diffuse(0.02)}
    spec["lamp"] = lamp((0, 120, 20), (0, 0, 20), 240, (2, 2, 2))
    pictures = [
        ("two_pass: slabs of 0.5, 1, 2, 4 and 8 mm", room.shoot(spec, 64, "two_pass", irradiance_paths=64)),
        ("volpathmis", room.volume(spec, keys, Medium.from_preset("marble"), 384)),
    ]
    return [save_rows(room.folder / "failure_thin.png", [[(c, enlarged(p, 3))] for c, p in pictures])]


def crease(room: Room) -> list[Path]:
    """A small cube with sharp edges: a flat half space has neither edges nor corners."""
    spec = start(PictureSettings(room.size(160, 128)), (-45, -70, 55), (0, 0, 9), fov=19.0)
    to_world = mi.ScalarTransform4f().translate([0, 0, 10.01]).scale(10)
    spec["box"] = {"type": "cube", "to_world": to_world, "bsdf": SMOOTH_MARBLE}
    spec["table"] = sweep(400, 80, (0.17, 0.172, 0.18))
    spec["lamp"] = lamp((-110, 30, 110), (0, 0, 9), 150, (3.2, 2.9, 2.5))
    spec["sky"] = {"type": "constant", "radiance": rgb(0.15, 0.17, 0.2)}
    pictures = [
        ("two_pass: a cube of 20 mm", room.shoot(spec, 64, "two_pass", irradiance_paths=64)),
        ("volpathmis", room.volume(spec, ["box"], Medium.from_preset("marble"), 512)),
    ]
    return [save_row(room.folder / "failure_crease.png", [(c, enlarged(p, 3)) for c, p in pictures])]


def few_samples(room: Room) -> list[Path]:
    """The teapot with too few surface samples, with the default number, and with too little light on them."""
    spec = build("teapot", resolution=room.size(340, 255))
    cases = (
        ("2,000 samples", {"sample_count": 2000, "irradiance_paths": 64}),
        ("one light path a sample", {"irradiance_paths": 1}),
        ("the defaults, 150,000 samples", {}),
    )
    pictures = [(caption, room.shoot(spec, 64, "two_pass", **settings)) for caption, settings in cases]
    return [save_row(room.folder / "failure_few_samples.png", pictures)]


FIGURES: dict[str, Callable[[Room], list[Path]]] = {
    "figure3": figure3,
    "figure4": figure4,
    "figure5": figure5,
    "environments": environments,
    "figure6": figure6,
    "materials": materials,
    "single_pass": single_pass,
    "capitals": capitals,
    "cuts": cuts,
    "models": models,
    "fit": fit,
    "lengths": lengths,
    "thin": thin,
    "crease": crease,
    "few_samples": few_samples,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=FIGURES, help="one of them")
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    arguments = parser.parse_args()
    mi.set_variant("llvm_ad_rgb")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(tempfile.gettempdir()) / "gallery" if arguments.quick else DOCS / "gallery"
        room = Room(folder, arguments.quick, Path(temporary))
        for name in [arguments.only] if arguments.only else FIGURES:
            began = time.perf_counter()
            for path in FIGURES[name](room):
                print(f"{path}: {path.stat().st_size // 1000} kB", flush=True)
            print(f"{name}: {time.perf_counter() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()

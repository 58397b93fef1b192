"""How evenly the atlas lays out surfaces, how much of the square it fills, and how long it takes.

    python benchmarks/atlas.py

writes docs/figures/atlas.json and atlas.png, and the tables of docs/theory/atlas.md between their marks. Takes about three
minutes on two cores; ``--quick`` leaves out the mesh of a million triangles and xatlas, and writes nothing.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import pellucid  # noqa: F401 isort: skip  (points Dr.Jit at its LLVM, which has to come before mitsuba)

import mitsuba as mi
import numpy as np

from support.record import DOCS, FIGURES, fill, markdown_table, save

COMMAND = "python benchmarks/atlas.py"
RESOLUTION = 1024
SHOWN = "antique_head"


def meshes(quick: bool) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Vertices and faces: models of the paper, balls with dents, a shape with a hole, noise, and loose triangles."""
    import trimesh

    from pellucid.scenes.models.scene import SHAPES, shape_mesh
    from pellucid.scenes.teapots.mesh import teapot_mesh

    found = {}
    for name in ("relief_head", "longneck", SHOWN):
        vertices, _, faces = shape_mesh(SHAPES[name])
        found[name] = (vertices, faces)
    teapot = teapot_mesh()
    found["teapot"] = (teapot.vertices, teapot.faces)
    torus = trimesh.creation.torus(2, 0.5, major_sections=200, minor_sections=100)
    found["torus"] = (torus.vertices, torus.faces)
    for level in (5, 6) if quick else (5, 6, 8):
        ball = trimesh.creation.icosphere(subdivisions=level)
        v = ball.vertices
        found[f"ball with dents, {level}"] = (v * (1 + 0.2 * np.sin(5 * v[:, :1]) * np.cos(4 * v[:, 1:2])), ball.faces)
    rng = np.random.default_rng(1)
    ball = trimesh.creation.icosphere(subdivisions=4)
    found["ball of noise"] = (ball.vertices + 0.05 * rng.normal(size=ball.vertices.shape), ball.faces)
    for count in (10_000, 100_000):
        corners = rng.random((count, 1, 3)) + 0.02 * rng.normal(size=(count, 3, 3))
        found[f"{count:,} loose triangles"] = (corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    return found


def body_of(vertices, faces):
    from pellucid.scene.bodies import Body, Part
    from pellucid.scene.meshes.buffers import mesh_from_arrays

    return Body("body", None, [Part(mesh_from_arrays("body", vertices, faces))])


def spread(area_surface: np.ndarray, area_texture: np.ndarray) -> dict:
    """The factor A_S / A_T over its mean: first and last hundredth of the texels, standard deviation; and coverage."""
    ratio = area_surface / np.maximum(area_texture, 1e-30)
    order = np.argsort(ratio)
    rank = np.cumsum(area_texture[order]) / area_texture.sum()
    low, high = (ratio[order[np.searchsorted(rank, q)]] for q in (0.01, 0.99))
    mean = np.average(ratio, weights=area_texture)
    deviation = np.sqrt(np.average((ratio - mean) ** 2, weights=area_texture))
    relative = {"low": low / mean, "high": high / mean, "deviation": deviation / mean}
    return {name: float(value) for name, value in relative.items()} | {"coverage": float(area_texture.sum())}


def missed(atlas) -> float:
    """The part of the surface in triangles that contain no texel centre: what plain rasterisation would lose."""
    pieces = atlas.fragments
    centre = np.stack([pieces.texel % RESOLUTION, pieces.texel // RESOLUTION], -1) + 0.5
    corners = atlas.uv[pieces.triangle] * RESOLUTION
    along, to = np.roll(corners, -1, axis=1) - corners, centre[:, None] - corners
    side = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    hit = np.zeros(len(atlas.prim), bool)
    hit[pieces.triangle[(side > 0).all(1) | (side < 0).all(1)]] = True
    return float(atlas.area_surface[~hit].sum() / atlas.area_surface.sum())


def measure(vertices, faces) -> dict:
    """Lay a mesh out and turn it into texels, and take the times."""
    from pellucid.scene.atlas.layout import build_atlas
    from pellucid.scene.atlas.texels import rasterise

    body = body_of(vertices, faces)
    start = perf_counter()
    atlas = build_atlas(body, RESOLUTION)
    built = perf_counter()
    texels = rasterise(atlas)
    seconds = {"build": built - start, "texels": perf_counter() - built}
    lost = abs(float(texels.samples.area.sum(dtype=float)) / atlas.surface.area - 1)
    counts = {"triangles": len(atlas.prim), "charts": len(np.unique(atlas.chart)), "texels": len(texels.texel)}
    return (
        counts
        | seconds
        | {"notes": atlas.notes, "lost": lost, "missed": missed(atlas)}
        | spread(atlas.area_surface, atlas.area_texture)
    )


def measure_libraries(vertices, faces) -> dict:
    """Compare the two libraries on the same mesh, without anything else."""
    from pellucid.scene.atlas.unwrapping import by_uvunwrap, by_xatlas
    from pellucid.scene.meshes.buffers import triangle_areas

    corners = np.asarray(vertices, float)[faces]
    result = {}
    for name, method in (("uvunwrap", by_uvunwrap), ("xatlas", by_xatlas)):
        start = perf_counter()
        uv, chart = method(corners, RESOLUTION)
        seconds = perf_counter() - start
        flat = triangle_areas(np.pad(uv, ((0, 0), (0, 0), (0, 1))))
        result[name] = spread(triangle_areas(corners), flat) | {"seconds": seconds, "charts": len(np.unique(chart))}
    return result


def picture(vertices, faces) -> None:
    """Draw the position map, the charts and the area that texels stand for."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from pellucid.scene.atlas.layout import build_atlas
    from pellucid.scene.atlas.texels import rasterise

    atlas = build_atlas(body_of(vertices, faces), RESOLUTION)
    texels = rasterise(atlas)
    p = texels.samples.p
    colour = np.random.default_rng(3).uniform(0.2, 0.95, (int(atlas.chart.max()) + 1, 3))
    maps = np.ones((3, RESOLUTION**2, 3))
    maps[0, texels.texel] = (p - p.min(0)) / np.ptp(p, axis=0)
    maps[1, atlas.fragments.texel] = colour[atlas.chart[atlas.fragments.triangle]]
    share = texels.samples.area * RESOLUTION**2 / atlas.surface.area * atlas.area_texture.sum()
    maps[2, texels.texel] = matplotlib.colormaps["viridis"](share / 2)[:, :3]
    fig, axes = plt.subplots(1, 3, figsize=(12, 4.4))
    titles = ("position", "charts", "area of a texel: 0 to twice the mean")
    for axis, image, title in zip(axes, maps, titles, strict=True):
        axis.imshow(image.reshape(RESOLUTION, RESOLUTION, 3), origin="lower", interpolation="antialiased")
        axis.set_title(title, fontsize=10)
        axis.axis("off")
    fig.tight_layout()
    fig.savefig(FIGURES / "atlas.png", dpi=80)
    plt.close(fig)


def tables(results: dict, libraries: dict) -> None:
    """Fill the document."""
    head = ["mesh", "triangles", "charts", "A_S / A_T", "deviation", "coverage", "lay out", "texels", "laid out by"]
    rows = [
        [
            name,
            f"{r['triangles']:,}",
            f"{r['charts']:,}",
            f"{r['low']:.2f} to {r['high']:.2f}",
            f"{r['deviation']:.2f}",
            f"{r['coverage']:.2f}",
            f"{r['build']:.2f} s",
            f"{r['texels']:.2f} s",
            r["notes"][-1].removeprefix("laid out by ").partition(",")[0],
        ]
        for name, r in results.items()
    ]
    lost = max(r["lost"] for r in results.values())
    text = f"`{COMMAND}`, {RESOLUTION} x {RESOLUTION} texels\n\n{markdown_table(head, rows)}\n\n"
    missing = ", ".join(f"{name} {r['missed']:.2%}" for name, r in results.items() if r["missed"] > 5e-5)
    text += f"The areas of all texels add up to that of the surface to {lost:.0e}.\n\n"
    text += f"Surface in triangles that contain no texel centre, which plain rasterisation would lose: {missing}; else below 0.005 %."
    fill(DOCS / "theory" / "atlas.md", "atlas", text)
    head = ["mesh", "library", "charts", "A_S / A_T", "deviation", "coverage", "time"]
    rows = []
    for name, both in libraries.items():
        for library, r in both.items():
            evenness = f"{r['low']:.2f} to {r['high']:.2f}", f"{r['deviation']:.2f}", f"{r['coverage']:.2f}"
            rows.append([name, library, str(r["charts"]), *evenness, f"{r['seconds']:.2f} s"])
    fill(DOCS / "theory" / "atlas.md", "libraries", f"`{COMMAND}`\n\n{markdown_table(head, rows)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small meshes, writes nothing")
    quick = parser.parse_args().quick
    mi.set_variant("llvm_ad_rgb")
    all_meshes = meshes(quick)
    measure(*all_meshes[SHOWN])  # compiles the kernels
    results, libraries = {}, {}
    for name, (vertices, faces) in all_meshes.items():
        r = results[name] = measure(vertices, faces)
        print(f"{name:24} {r['triangles']:9,} {r['build']:6.2f} s {r['texels']:6.2f} s  {r['notes']}", flush=True)
    if quick:
        return
    for name in (SHOWN, "teapot", "torus", "ball of noise"):
        libraries[name] = measure_libraries(*all_meshes[name])
        print(name, {library: round(r["seconds"], 2) for library, r in libraries[name].items()}, flush=True)
    save("atlas", COMMAND, {"resolution": RESOLUTION, "meshes": results, "libraries": libraries})
    picture(*all_meshes[SHOWN])
    tables(results, libraries)


if __name__ == "__main__":
    main()

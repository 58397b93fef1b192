"""One process of two threads against one and two workers of one thread: a turn, a large picture, many samples.

    python benchmarks/cluster.py

writes docs/figures/cluster.json and the tables of docs/many_machines.md between their marks. Takes about twenty minutes on two cores;
``--quick`` is small and rough, and writes nothing; ``--tables`` writes the tables from what was measured before.

Kernels have been compiled before, and workers have been started. From there on all counts: loading the scene, preparation, pieces, and
bringing the results to one process.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM)

import mitsuba as mi  # isort: skip
import drjit as dr
import numpy as np

from support.many_workers import Run, of_light, of_pieces
from support.record import DOCS, as_command, markdown_table

mi.set_variant("llvm_ad_rgb")

from pellucid.cluster import cluster as module  # noqa: E402
from pellucid.cluster.cluster import Cluster  # noqa: E402
from pellucid.jobs.job import Request  # noqa: E402
from pellucid.jobs.orbit import Orbit  # noqa: E402
from pellucid.jobs.output import save_film  # noqa: E402
from pellucid.jobs.tiles import Tile, merge  # noqa: E402

COMMAND = "python benchmarks/cluster.py"
GOAL_WORKERS, GOAL_PROCESS = 1.8, 1.1
"""Two workers are to be so many times as fast as one, and to take at most so many times as long as one process of two threads."""

START, TASK = "start of", "overhead of a task"

MANY = (1, 10, 100, 1000)
PAPER = [
    ("turn of 2,400 frames, 640x480", 100),
    ("picture of 8192x6144, in 384 tiles", 16),
    ("2 million samples, light in parts", 0),
]
"""Workers of the model on paper, and its jobs: how many times as many pieces as were measured; 0 for light that is shared."""


@dataclass
class Case:
    """One of the jobs: what it is called, its request, and in how many frames; without frames it is a picture in tiles."""

    name: str
    options: dict[str, Any]
    frames: int = 0

    def request(self, threads: int) -> Request:
        """Ask for it with so many threads a process."""
        return Request.of("teapot", denoise=False, threads=threads, **self.options)


def cases(quick: bool) -> list[Case]:
    """List the jobs."""
    if quick:
        module.TILE_SIDE, module.SHARED_PATHS = 128, 1 << 20
        small = {"spp": 2, "sample_count": 2000, "sampling": "uniform", "irradiance_paths": 16}
        return [
            Case("turn of 4 frames", {**small, "resolution": (160, 120)}, 4),
            Case("picture of 384x256 in tiles", {**small, "resolution": (384, 256)}),
            Case(
                "100,000 samples, light in parts",
                {"resolution": (64, 48), "spp": 1, "sample_count": 100_000, "sampling": "uniform"},
            ),
        ]
    return [
        Case("turn of 24 frames, 640x480", {"resolution": (640, 480), "spp": 4}, 24),
        Case("picture of 2048x1536, in 24 tiles", {"resolution": (2048, 1536), "spp": 4}),
        Case(
            "2 million samples, light in 8 parts",
            {"resolution": (64, 48), "spp": 1, "sample_count": 2_000_000, "sampling": "uniform"},
        ),
    ]


def here(case: Case, threads: int) -> None:
    """Do a job in this process, as the commands do."""
    dr.set_thread_count(threads)
    job = case.request(threads).load()
    integrator = job.integrator()
    job.prepare(integrator)
    orbit = Orbit.around(job.sensor, integrator.prepared.bodies)
    with tempfile.TemporaryDirectory() as folder:
        for frame in range(max(case.frames, 1)):
            orbit.place(job.sensor, 2 * np.pi * frame / max(case.frames, 1))
            job.render(integrator)
            save_film(job.sensor.film(), [Path(folder) / "frame.png"])
    dr.sync_thread()


def on(cluster: Cluster, case: Case) -> Run:
    """Do a job on workers of one thread."""
    before, began, back = sent(cluster), time.perf_counter(), []
    if case.frames:
        cluster.render_frames(
            case.request(1), list(range(case.frames)), case.frames, lambda *_: back.append(time.perf_counter())
        )
    else:
        tiles: list[Tile] = []

        def keep(tile: Tile) -> None:
            tiles.append(tile)
            back.append(time.perf_counter())

        cluster.render_tiles(case.request(1), lambda _: set(), keep)
        with tempfile.TemporaryDirectory() as folder:
            save_film(merge(tiles)[0], [Path(folder) / "picture.png"])
    return Run(time.perf_counter() - began, back[0] - began, len(back), sent(cluster) - before)


def sent(cluster: Cluster) -> int:
    """Add up the bytes that all workers have sent so far, to each other and to this process."""
    return sum(cluster._client.run(lambda dask_worker: dask_worker.transfer_outgoing_bytes_total).values())


def overhead(cluster: Cluster, count: int = 500) -> float:
    """Tell how long a task takes [s] that does nothing."""
    began = time.perf_counter()
    cluster._client.gather([cluster._client.submit(abs, k, pure=False) for k in range(count)])
    return (time.perf_counter() - began) / count


def timed(work: Callable[[], object], repeats: int) -> float:
    """Run something once to compile its kernels, then tell its median time [s]."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def measure(quick: bool) -> dict[str, Any]:
    """Do all jobs in one process, on one worker and on two."""
    repeats, found = 1 if quick else 3, {}
    process = {}
    for case in cases(quick):
        process[case.name] = timed(lambda case=case: here(case, 2), repeats)
        print(f"one process: {case.name} {process[case.name]:.2f} s", flush=True)
    runs: dict[str, dict[str, Any]] = {}
    for count in (1, 2):
        began = time.perf_counter()
        with Cluster(f"local:{count}") as cluster:
            found[f"{START} {count} workers [s]"] = time.perf_counter() - began
            found[f"{TASK}, {count} workers [s]"] = overhead(cluster)
            for case in cases(quick):
                on(cluster, case)
                several = [on(cluster, case) for _ in range(repeats)]
                run = sorted(several, key=lambda run: run.seconds)[repeats // 2]
                runs.setdefault(str(count), {})[case.name] = vars(run)
                print(f"{count} workers: {case.name} {run.seconds:.2f} s", flush=True)
    return {"one process": process, "workers": runs, **found}


def measured(results: dict[str, Any]) -> str:
    """Write the table of what was measured."""
    rows = []
    for name, alone in results["one process"].items():
        one, two = (Run(**results["workers"][count][name]) for count in "12")
        shown = [f"{seconds:.1f} s" for seconds in (alone, one.seconds, two.seconds)]
        shown += [f"{one.seconds / two.seconds:.2f}", f"{two.seconds / alone:.2f}"]
        rows.append([name, *shown, f"{two.first:.1f} s", f"{two.sent / 1e6:.1f} MB"])
    goals = ["goal", "", "", "", f"at least {GOAL_WORKERS}", f"at most {GOAL_PROCESS}", "", ""]
    times = ["one process, 2 threads", "1 worker", "2 workers", "speed-up", "of one process"]
    start, a_task = results[f"{START} 2 workers [s]"], results[f"{TASK}, 2 workers [s]"]
    return (
        f"`{COMMAND}`\n\n{markdown_table(['', *times, 'first piece', 'sent'], [*rows, goals])}\n\n"
        f"Two workers of this machine take their first task after {start:.1f} s. A task that does nothing takes {1e3 * a_task:.2f} ms."
    )


def on_paper(results: dict[str, Any]) -> str:
    """Write the table of the model: what was measured with one worker and two, extended to many."""
    a_task = results[f"{TASK}, 2 workers [s]"]
    rows = []
    for (name, times), title in zip(PAPER, results["one process"], strict=True):
        one, two = (Run(**results["workers"][count][title]) for count in "12")
        found = [
            of_pieces(one, a_task, workers, times) if times else of_light(one, two, a_task, workers) for workers in MANY
        ]
        for workers, estimate in zip(MANY, found, strict=True):
            parts = [f"{seconds:.3g} s" for seconds in vars(estimate).values()]
            speed = f"{found[0].seconds / estimate.seconds:.3g}"
            rows.append([name, workers, *parts, f"{estimate.seconds:.3g} s", speed, estimate.bottleneck])
    heads = ["", "workers", "preparation", "pieces", "scheduler", "network", "in all", "speed-up", "bottleneck"]
    return f"`{COMMAND}`\n\n{markdown_table(heads, rows)}"


def main() -> None:
    as_command(
        "cluster",
        COMMAND,
        DOCS / "many_machines.md",
        measure,
        lambda results: {"cluster": measured(results), "cluster on paper": on_paper(results)},
        __doc__,
    )


if __name__ == "__main__":
    main()

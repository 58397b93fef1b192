"""Samples that stay in parts on one worker and on two, against all samples on each: time, memory, what is sent, and how pictures differ.

    python benchmarks/sample_parts.py

writes docs/figures/sample_parts.json and a table of docs/many_machines.md between its marks. Takes about five minutes on two cores;
``--quick`` is small and rough, and writes nothing; ``--tables`` writes the table from what was measured before.

Kernels have been compiled before. Each row has workers of its own, of one thread.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pellucid  # noqa: F401  (points Dr.Jit at its LLVM)

import mitsuba as mi  # isort: skip
import cloudpickle
import numpy as np

from support.record import DOCS, as_command, markdown_table

mi.set_variant("llvm_ad_rgb")

from pellucid.cluster.cluster import Cluster  # noqa: E402

COMMAND = "python benchmarks/sample_parts.py"
CASES = ((1, 0), (2, 0), (1, 8), (2, 8), (2, 4), (2, 2))
"""Workers, and parts of the samples; 0 for all of them on each worker."""

HEADS = ["workers", "samples", "time", "samples and trees on a worker", "its memory at most", "sent", "RMSE", "mean"]


def peak() -> int:
    """Read how much memory this process has had at most [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


def kept() -> int:
    """Add up the samples, their light and trees that this worker keeps [bytes]."""
    from pellucid.cluster import worker

    states = [state for o in worker._opened.values() for state in (*o.parts.values(), o.integrator.prepared)]
    lit = [each for state in states if state is not None for each in state.bodies]
    return sum(worker._size([each.samples, each.irradiance, each.state]) for each in lit if each.state is not None)


def sent(dask_worker: Any) -> int:
    """Read the bytes that this worker has sent."""
    return dask_worker.transfer_outgoing_bytes_total


def of(workers: int, parts: int, options: dict[str, Any]) -> tuple[dict[str, Any], np.ndarray]:
    """Render with the samples in so many parts, or with all on each worker."""
    held: list[int] = []
    collect = Cluster._collect

    def collected(self: Cluster, stage: str, *arguments: Any, **more: Any) -> Any:
        done = collect(self, stage, *arguments, **more)
        if stage == "tiles":
            held.extend(self._client.run(kept).values())
        return done

    Cluster._collect = collected  # type: ignore[method-assign]
    try:
        with Cluster(f"local:{workers}") as cluster:
            began = time.perf_counter()
            picture = cluster.render("teapot", sample_parts=parts, threads=1, **options)
            seconds = time.perf_counter() - began
            most, bytes_sent = max(cluster._client.run(peak).values()), sum(cluster._client.run(sent).values())
    finally:
        Cluster._collect = collect  # type: ignore[method-assign]
    return {"seconds": seconds, "kept": max(held), "peak": most, "sent": bytes_sent}, picture


def measure(quick: bool) -> dict[str, Any]:
    """Render with all samples on each worker, and with several numbers of parts."""
    count, size = (20_000, (160, 120)) if quick else (1_000_000, (640, 480))
    options = {"sample_count": count, "resolution": size, "spp": 4, "sampling": "uniform"}
    for parts in (0, 2):
        of(1, parts, {**options, "sample_count": 10_000})
    rows, whole = [], None
    for workers, parts in CASES:
        found, picture = of(workers, parts, options)
        whole = picture if whole is None else whole
        difference = (picture - whole).astype(float)
        found |= {"workers": workers, "parts": parts, "mean": float(picture.mean() / whole.mean() - 1)}
        rows.append(found | {"rmse": float(np.sqrt(np.mean(difference**2)) / whole.mean())})
        print(rows[-1], flush=True)
    return {"samples": count, "rows": rows}


def table(results: dict[str, Any]) -> str:
    """Write the table."""
    rows = []
    for row in results["rows"]:
        name = f"{row['parts']} parts" if row["parts"] else "all on each"
        shown = [f"{row['seconds']:.1f} s", f"{row['kept'] / 1e6:.0f} MB", f"{row['peak'] / 1e9:.2f} GB"]
        differs = [f"{row['rmse']:.2%}", f"{row['mean']:+.3%}"] if row["parts"] else ["", ""]
        rows.append([row["workers"], name, *shown, f"{row['sent'] / 1e6:.0f} MB", *differs])
    return f"`{COMMAND}`\n\n{markdown_table(HEADS, rows)}"


def main() -> None:
    as_command(
        "sample_parts",
        COMMAND,
        DOCS / "many_machines.md",
        measure,
        lambda results: {"sample parts": table(results)},
        __doc__,
    )


if __name__ == "__main__":
    import sys

    cloudpickle.register_pickle_by_value(sys.modules[__name__])
    main()

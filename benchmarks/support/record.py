"""Keep a benchmark's results: as JSON beside the figures, and as a table between two marks of a document."""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import statistics
import time
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[2] / "docs"
FIGURES = DOCS / "figures"


def machine() -> dict[str, Any]:
    """Describe the machine and the versions that a figure was measured with."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = re.findall(r"model name\s*: (.*)", info.read_text())
        cpu = names[0] if names else cpu
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **{package: version(package) for package in ("pellucid", "mitsuba", "drjit", "numpy")},
    }


def seconds(work: Callable[[], Any], repeats: int = 3) -> list[float]:
    """Time some work a few times, after one run that compiles its kernels."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return times


def median(times: Iterable[float]) -> float:
    """Take the median of a few times."""
    return statistics.median(times)


def save(name: str, command: str, results: Any) -> Path:
    """Write results, with the command and the machine they come from, to ``docs/figures/<name>.json``."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    path, unfinished = FIGURES / f"{name}.json", FIGURES / f"{name}.json.tmp"
    unfinished.write_text(json.dumps({"command": command, "machine": machine(), "results": results}, indent=1) + "\n")
    unfinished.replace(path)
    return path


def saved(name: str) -> dict[str, Any]:
    """Read the results that an earlier run has saved; nothing if there was none."""
    path = FIGURES / f"{name}.json"
    return json.loads(path.read_text())["results"] if path.exists() else {}


def markdown_table(head: list[str], rows: Iterable[Iterable[Any]]) -> str:
    """Format rows as a Markdown table."""
    lines = [head, ["---"] * len(head), *([str(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def fill(document: Path, mark: str, text: str) -> None:
    """Replace what stands between ``<!-- mark -->`` and ``<!-- /mark -->`` in a document."""
    opening, closing = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    content = document.read_text()
    before, _, rest = content.partition(opening)
    _, found, after = rest.partition(closing)
    if not found:
        raise ValueError(f"{document} has no place marked {opening} ... {closing}.")
    document.write_text(f"{before}{opening}\n{text}\n{closing}{after}")


def as_command(
    name: str,
    command: str,
    document: Path,
    measure: Callable[[bool], Any],
    tables: Callable[[Any], dict[str, str]],
    description: str | None,
) -> None:
    """Be the command of a benchmark: measure, print the tables, save the results, and fill the tables into a document by their marks.

    With ``--quick`` what is measured is small and rough, and nothing is written; with ``--tables`` nothing is measured.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    parser.add_argument("--tables", action="store_true", help="write the tables from what was measured before")
    arguments = parser.parse_args()
    results = saved(name) if arguments.tables else measure(arguments.quick)
    written = tables(results)
    print(*written.values(), sep="\n\n")
    if arguments.quick:
        return
    if not arguments.tables:
        save(name, command, results)
    for mark, text in written.items():
        fill(document, mark, text)

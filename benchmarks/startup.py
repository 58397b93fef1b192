"""From the shell prompt to the first picture: `pellucid render teapot` at its default settings.

    python benchmarks/startup.py

writes docs/figures/startup.json and the table of docs/benchmarks.md between its marks. Takes about a minute on two
cores; ``--quick`` renders a small picture, and writes nothing.

Dr.Jit keeps compiled kernels in ``~/.drjit``. The first run has a home directory of its own without any; the others
find there what it has compiled. Python and Mitsuba have been read from disk before.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from support.record import DOCS, fill, markdown_table, median, save

COMMAND = "python benchmarks/startup.py"
RENDER = ["-m", "pellucid", "render", "teapot", "--quiet"]
IMPORT = ["-c", "import pellucid"]
READY = ["-c", "import pellucid, mitsuba; mitsuba.set_variant('llvm_ad_rgb')"]
GOALS = {"first picture, no kernel compiled before": 10, "picture, kernels cached": 5}
SMALL = ["--resolution", "128x96", "--samples", "5000"]


def seconds(arguments: list[str], home: Path) -> float:
    """Run Python in a process of its own with a home directory, and tell how long it took [s]."""
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, cwd=home, env={**os.environ, "HOME": str(home)})
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small and rough, to see that it runs")
    quick = parser.parse_args().quick
    render = [*RENDER, *(SMALL if quick else [])]
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        bare = [seconds(["-c", ""], folder) for _ in range(3)]
        seconds(READY, folder)  # brings the files to memory
        times["`import pellucid`"] = [seconds(IMPORT, folder) - median(bare) for _ in range(3)]
        times["`import pellucid`, and a variant set"] = [seconds(READY, folder) - median(bare) for _ in range(3)]
        cold, warm = GOALS
        times[cold] = [seconds(render, folder)]
        kernels = len(list((folder / ".drjit").glob("*.bin")))
        times[warm] = [seconds(render, folder) for _ in range(3)]
    rows = []
    for what, values in times.items():
        goal = f"{GOALS[what]} s" if what in GOALS else ""
        rows.append([what, f"{median(values):.2f} s", goal])
        print(f"{what:42} {median(values):6.2f} s   {goal and 'goal: ' + goal}", flush=True)
    print(f"{kernels} kernels")
    if not quick:
        save("startup", COMMAND, {"seconds": times, "kernels": kernels})
        text = f"`{COMMAND}`\n\n{markdown_table(['', 'time', 'goal'], rows)}\n\nThe picture needs {kernels} kernels."
        fill(DOCS / "benchmarks.md", "startup", text)


if __name__ == "__main__":
    main()

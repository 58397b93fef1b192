"""Make the references of the image tests from the code as it is:

    python tests/images/make_references.py                    # all: about half an hour on two cores
    python tests/images/make_references.py --scenes teapot    # some; the others stay as they are

Run it when a method changes on purpose what its pictures are in the mean, not when only its random numbers change: the
references hold means and standard deviations over many seeds, of the samples and lights as well as of the paths.
Say in the commit why the pictures change, and by how much (the command prints it).
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

import pellucid  # noqa: F401  (before mitsuba: it says which LLVM compiles the kernels)

import mitsuba as mi  # isort: skip

COUNT = 24
FIRST_SEED = 1000


def main() -> None:
    """Render every picture with many seeds, and write down what the tests need."""
    root = Path(__file__).parents[2]
    sys.path[:0] = [str(root / "tests"), str(root / "benchmarks")]
    mi.set_variant("llvm_ad_rgb")
    from images.pictures import BLOCKS, block_means, cases, load, read_references, render, write_references

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="", help="names, comma-separated; all if left out")
    parser.add_argument("--methods", default="", help="the same for the methods")
    parser.add_argument(
        "--count", type=int, default=COUNT, help="pictures of each; all references have the same number"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    references = read_references()
    loaded, scene = "", None
    for name, method in cases():
        if not _asked(name, options.scenes) or not _asked(method, options.methods):
            continue
        if name != loaded:
            loaded, scene = name, load(name)
        pictures = np.stack([render(scene, method, FIRST_SEED + k) for k in range(options.count)])
        found = {size: block_means(pictures, shape) for size, shape in BLOCKS.items()}
        before = references.get((name, method))
        references[name, method] = {size: (x.mean(axis=0), x.std(axis=0, ddof=1)) for size, x in found.items()}
        mean, deviation = (x[0, 0, [1, 4]] for x in references[name, method]["whole"])
        change = "" if before is None else f", {100 * (mean / before['whole'][0][0, 0, [1, 4]] - 1)} % against before"
        print(f"{name}, {method}: radiance, exitance {mean} +- {100 * deviation / mean} %{change}", flush=True)
        write_references(references, options.count)


def _asked(name: str, names: str) -> bool:
    """Tell whether a name is in a list, if there is one."""
    return not names or name in names.split(",")


if __name__ == "__main__":
    main()

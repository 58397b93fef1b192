"""Write the pages that run in the documentation: ``python docs/live.py`` before the site is built. Takes two minutes.

They are not kept beside the sources: three megabytes that a command makes. A site that is built without them shows their
commands instead.
"""

import subprocess
import sys
from pathlib import Path

LIVE = Path(__file__).parent / "_live" / "live"
PAGES = {
    "antique_head": "--material skin2 --size 60",
    "relief_head": "--reflectance 0.25,0.62,0.38 --dmfp 2.5 --size 50",
    "philosopher": "--material marble --size 40",
    "horned_head": "--material wholemilk --size 30",
    "longneck": "--material cream --size 25",
    "wanderer": "--reflectance 0.9,0.62,0.2 --dmfp 4 --size 40",
}
"""Scenes, and what they are made of."""


def command(name: str) -> list[str]:
    """Write the command that makes one of the pages."""
    return ["export", name, *PAGES[name].split()]


if __name__ == "__main__":
    LIVE.mkdir(parents=True, exist_ok=True)
    for name in PAGES:
        subprocess.run([sys.executable, "-m", "pellucid", *command(name)], cwd=LIVE, check=True)

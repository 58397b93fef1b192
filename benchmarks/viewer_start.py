"""From the shell prompt to the first frame of `pellucid view teapot` in a page that waits for it.

    python benchmarks/viewer_start.py

writes docs/figures/viewer_start.json and the table of docs/viewer.md between its marks. Takes about a minute on two
cores; ``--quick`` starts it once, and writes nothing.

The client is a WebSocket that announces itself as a page does, so that no browser takes part in the times. The first run
has a home directory of its own, in which Dr.Jit finds no compiled kernel; the others find there what it has compiled.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from support.record import DOCS, fill, markdown_table, median, save

COMMAND = "python benchmarks/viewer_start.py"
GOALS = {"first frame, no kernel compiled before": None, "first frame, kernels cached": 5}
WINDOW = (900, 600)
JPEG = b"\xff\xd8\xff"
PATIENCE = 120  # seconds


def free_port() -> int:
    """Find a port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def first_frame(port: int, deadline: float) -> None:
    """Wait until a server is there, look at it as a page does, and return when the first frame has come."""
    import msgspec
    import viser
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    protocol = f"viser-v{viser.__version__}"
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, -3.0, 1.0),
        "fov": 0.6,
        "near": 0.01,
        "far": 1000.0,
        "image_height": WINDOW[1],
        "image_width": WINDOW[0],
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
    }
    while time.perf_counter() < deadline:
        try:
            with connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None, compression=None) as page:
                page.send(msgspec.msgpack.encode(camera))
                while JPEG not in page.recv(timeout=deadline - time.perf_counter()):
                    pass
                return
        except (OSError, ConnectionClosed):
            time.sleep(0.01)
    raise TimeoutError("no frame came")


def seconds(home: Path) -> float:
    """Start the viewer in a process of its own with a home directory, and tell how long its first frame took [s]."""
    port = free_port()
    start = time.perf_counter()
    command = [sys.executable, "-m", "pellucid", "view", "teapot", "--no-browser", "--quiet", "--port", str(port)]
    process = subprocess.Popen(command, cwd=home, env={**os.environ, "HOME": str(home)}, stderr=subprocess.DEVNULL)
    try:
        first_frame(port, start + PATIENCE)
        return time.perf_counter() - start
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="once, to see that it runs")
    quick = parser.parse_args().quick
    cold, warm = GOALS
    times: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as home:
        times[cold] = [seconds(Path(home))]
        if not quick:
            times[warm] = [seconds(Path(home)) for _ in range(5)]
    for what, values in times.items():
        print(f"{what:42} {median(values):6.2f} s   ({min(values):.2f} to {max(values):.2f})", flush=True)
    if not quick:
        save("viewer_start", COMMAND, {"seconds": times})
        rows = [[what, f"{median(times[what]):.1f} s", f"{goal} s" if goal else ""] for what, goal in GOALS.items()]
        fill(DOCS / "viewer.md", "viewer_start", f"`{COMMAND}`\n\n{markdown_table(['', 'time', 'goal'], rows)}")


if __name__ == "__main__":
    main()

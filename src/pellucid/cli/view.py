"""``pellucid view``: the scene in a page of the browser, where light, material, size and camera move."""

from __future__ import annotations

from typing import Any

import click

from ..errors import warn
from ..jobs.job import Request
from .interrupts import interruptible
from .options import scene_options, session_options
from .session import session

EXAMPLES = """\b
Examples:
  pellucid view teapot
  pellucid view bunny.ply --material skin1 --size 30
  pellucid view scene.xml --port 9000 --no-browser

\b
From another machine, through SSH:
  ssh -L 8080:localhost:8080 HOST pellucid view teapot --no-browser
"""


@click.command(epilog=EXAMPLES)
@scene_options
@click.option("--host", metavar="ADDRESS", default="127.0.0.1", show_default=True, help="Address to listen at.")
@click.option("--port", type=click.IntRange(1, 65535), metavar="N", default=8080, show_default=True, help="Its port.")
@click.option("--no-browser", is_flag=True, help="Serve the page, but do not open it.")
@session_options
def view(host: str, port: int, no_browser: bool, **options: Any) -> None:
    """Show SCENE in the browser, in real time.

    The page turns, lights, and changes the material and the size of the translucent objects, compares the view with
    the two-pass method, and saves it as a picture or as a scene. Anyone who can reach the address can use it: by default
    nobody but this machine. Ctrl-C ends it.
    """
    request = Request.from_options(options)
    request.check()
    from ..viewer.opening import Opening, check_installed, check_port, other_address, page_address

    check_installed()
    check_port(host, port)
    opening = Opening(host, port, request.name)
    with interruptible(lambda: "the viewer is closed"), session(request.session):
        _show(request, opening, page_address(host, port), other_address(host, port), not no_browser)


def _show(request: Request, opening: Any, address: str, elsewhere: str | None, browser: bool) -> None:
    """Prepare the scene and draw it until Ctrl-C."""
    from ..realtime.engine import Engine
    from ..viewer.opening import show_page
    from ..viewer.saving import Origin
    from ..viewer.server import Viewer

    job = request.load()
    if browser:  # while it starts, the scene is prepared
        opening.server()
        show_page(address)
    engine = Engine(job.scene)
    engine.settings.method = "hybrid"  # as fast as the plain method, and smooth where few samples are not
    engine.settings.timed = True  # the page shows the stages
    origin = Origin(request.source, request.definitions, request.load_options())
    viewer = Viewer(opening.server(), engine, request.name, origin, job.sensor)
    with interruptible(stop=viewer.loop.stop):
        if not request.session.quiet:
            click.echo(f"{address}  (Ctrl-C ends)")
            if elsewhere is not None:
                click.echo(f"{elsewhere}  (from other machines)")
                warn("Everyone who can reach this address can use the viewer, and save scenes on this machine.")
        viewer.run()
    raise KeyboardInterrupt  # nothing else stops the loop

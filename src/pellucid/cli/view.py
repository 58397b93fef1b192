"""``pellucid view``: the scene in a page of the browser, where light, material, size and camera move."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import SceneError, warn
from ..jobs.job import Job, Request
from .interrupts import interruptible
from .options import scene_options, session_options
from .session import session

if TYPE_CHECKING:
    from ..page.scene import PageScene

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
@click.option(
    "--streamed", is_flag=True, help="Draw on this machine, with all that is in the scene, and send pictures."
)
@session_options
def view(host: str, port: int, no_browser: bool, streamed: bool, **options: Any) -> None:
    """Show SCENE in the browser, in real time.

    The page turns, lights, and changes the material and the size of the translucent objects, compares the view with
    the two-pass method, and saves it as a picture or as a scene. A scene of one closed mesh under lamps that are points is
    drawn by the browser, on its graphics card; all others on this machine. By default nobody but this machine can reach the
    address. Ctrl-C ends it.
    """
    request = Request.from_options(options)
    request.check()
    from ..viewer.opening import check_port

    check_port(host, port)
    with interruptible(lambda: "the viewer is closed"), session(request.session):
        job = request.load()
        contents, reason = (None, "") if streamed else page_contents(job)
        if contents is not None:
            _serve_page(job, contents, host, port, not no_browser)
        else:
            _stream(job, reason, host, port, not no_browser)
    raise KeyboardInterrupt  # nothing else ends it


def page_contents(job: Job) -> tuple[PageScene | None, str]:
    """Take what a page shows from a scene, if that is all there is; else None, and why.

    The table and the lamps around a bare mesh are ours: the page has a floor and points in their place.
    """
    from ..methods.thin import warn_of_thin_parts
    from ..page.scene import page_scene
    from ..scenes.loading import MESH_FORMATS

    try:
        contents = page_scene(job.scene, job.request.name, job.sensor)
    except SceneError as error:
        return None, str(error)
    if any(part.to_world is not None for part in contents.body.parts):
        return None, "The translucent body is an instance."
    is_mesh = Path(job.request.source).suffix.lower() in MESH_FORMATS
    if contents.notes and not is_mesh:
        return None, f"In a page that the browser draws, {'; '.join(contents.notes)}."
    warn_of_thin_parts(contents.body, "The page")
    return contents, ""


def other_contents(request: Request, path: str) -> PageScene:
    """Take what a page shows from another scene, asked for with the same options.

    Raises
    ------
    SceneError
        Where it cannot be loaded, or a page cannot show it.
    """
    another = replace(request, source=path)
    another.check()
    contents, reason = page_contents(another.load())
    if contents is None:
        raise SceneError(f"{reason} 'pellucid view {path}' draws it on this machine.")
    return contents


def _announce(request: Request, address: str, elsewhere: str | None) -> None:
    """Say where the page is."""
    if request.session.quiet:
        return
    click.echo(f"{address}  (Ctrl-C ends)")
    if elsewhere is not None:
        click.echo(f"{elsewhere}  (from other machines)")


def _serve_page(job: Job, contents: PageScene, host: str, port: int, browser: bool) -> None:
    """Serve the page that the browser draws, until Ctrl-C."""
    from ..viewer.opening import other_address, page_address, show_page
    from ..viewer.page_server import PageServer
    from ..viewer.page_session import PageSession

    work = PageSession(contents, lambda path: other_contents(job.request, path))
    with PageServer(host, port, work) as server:
        query = f"/?token={server.token}" if server.token else ""
        address, elsewhere = page_address(host, port) + query, other_address(host, port)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with interruptible(stop=work.end):
            _announce(job.request, address, elsewhere and elsewhere + query)
            if browser:
                show_page(address)
            work.run()
        server.shutdown()


def _stream(job: Job, reason: str, host: str, port: int, browser: bool) -> None:
    """Draw the scene here until Ctrl-C."""
    from ..realtime.engine import Engine
    from ..viewer.opening import Opening, check_installed, other_address, page_address, show_page
    from ..viewer.saving import Origin
    from ..viewer.server import Viewer

    check_installed()
    request = job.request
    opening = Opening(host, port, request.name)  # while it starts, the scene is prepared
    if browser:
        opening.server()
        show_page(page_address(host, port))
    engine = Engine(job.scene)
    engine.settings.method = "hybrid"  # as fast as the plain method, and smooth where few samples are not
    engine.settings.timed = True  # the page shows the stages
    origin = Origin(request.source, request.definitions, request.load_options())
    viewer = Viewer(opening.server(), engine, request.name, origin, job.sensor, reason)
    with interruptible(stop=viewer.loop.stop):
        _announce(request, page_address(host, port), other_address(host, port))
        if other_address(host, port) is not None:
            warn("Everyone who can reach this address can use the viewer, and save scenes on this machine.")
        viewer.run()

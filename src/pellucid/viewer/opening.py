"""The server, before there is anything to show: it opens at once, while the scene is still being prepared."""

from __future__ import annotations

import importlib.util
import socket
import threading
import webbrowser
from typing import Any

from ..errors import EnvironmentProblem, install
from .guard import EVERYWHERE, Door, check_messages, guarded, is_loopback

BRAND = (222, 160, 90)


def check_port(host: str, port: int) -> None:
    """Check that a server can listen at a port.

    Raises
    ------
    EnvironmentProblem
        When something else does, or the address is not one of this machine.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise EnvironmentProblem(
            f"The viewer cannot listen at {host}:{port}: {reason}. Give another port, as in --port {port % 65535 + 1}, "
            "or another address with --host."
        ) from None


def check_installed() -> None:
    """Check that viser is there.

    Raises
    ------
    EnvironmentProblem
        When it is not installed.
    """
    if importlib.util.find_spec("viser") is None:
        raise EnvironmentProblem(f"The viewer needs viser: {install('viewer')}.")


def page_address(host: str, port: int) -> str:
    """Write the address of the page for a browser on this machine."""
    name = "localhost" if host in EVERYWHERE else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"


def other_address(host: str, port: int) -> str | None:
    """Write the address of the page for other machines; None where none can reach it."""
    if is_loopback(host):
        return None
    if host not in EVERYWHERE:
        return page_address(host, port)
    family, elsewhere = (socket.AF_INET6, "2001:db8::1") if ":" in host else (socket.AF_INET, "192.0.2.1")
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((elsewhere, 9))  # sends nothing, but chooses the address that is seen from outside
            return page_address(probe.getsockname()[0], port)
    except OSError:
        return page_address(socket.gethostname(), port)


def open_server(host: str, port: int, name: str) -> Any:
    """Start a server whose page says that the scene is being prepared.

    Raises
    ------
    EnvironmentProblem
        When the port was taken meanwhile.
    """
    import rich
    import viser

    rich.get_console().quiet = True  # on which viser announces itself
    with guarded(Door(host)):
        server = viser.ViserServer(host=host, port=port, label=f"pellucid · {name}", verbose=False)
    if server.get_port() != port:  # viser looks for the next free one
        server.stop()
        raise EnvironmentProblem(f"Port {port} was taken a moment ago: give another, as in --port {port % 65535 + 1}.")
    check_messages(server)
    server.request_share_url = _nobody  # type: ignore[method-assign]  # a page must not make this machine public
    server.gui.configure_theme(
        dark_mode=True, control_width="large", show_logo=False, show_share_button=False, brand_color=BRAND
    )
    server.scene.world_axes.visible = False
    server.gui.add_markdown("**Preparing the scene** …  \nThe first time, kernels are compiled for it.")
    return server


def _nobody(verbose: bool = True) -> None:
    """Share the page with nobody."""


class Opening:
    """Opens the server on a thread of its own."""

    def __init__(self, host: str, port: int, name: str):
        self._server: Any = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._open, args=(host, port, name), daemon=True)
        self._thread.start()

    def _open(self, host: str, port: int, name: str) -> None:
        try:
            self._server = open_server(host, port, name)
        except BaseException as error:  # raised again where it is waited for
            self._error = error

    def server(self) -> Any:
        """Wait for the server."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._server


def show_page(address: str) -> None:
    """Open a page in the browser of this machine, if there is one, without waiting for it."""
    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

"""Who may talk to the viewer, and what they may say: other web pages are refused, and values out of range."""

from __future__ import annotations

import ipaddress
import logging
import socket
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from numbers import Real
from typing import Any
from urllib.parse import SplitResult, urlsplit

import numpy as np

from ..errors import warn

EVERYWHERE = ("0.0.0.0", "::")  # addresses that stand for all of a machine
LOOPBACK = ("localhost", "127.0.0.1", "::1")
FARTHEST = 1e6
"""Radii of the bodies at which a camera or a handle may be."""
LARGEST = 1e9
"""The largest number of a control that has no limits."""
WIDEST = 1 << 14
"""Pixels across a window."""


def is_loopback(host: str) -> bool:
    """Tell whether an address is reached from this machine alone."""
    return host in LOOPBACK or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    """Tell whether a name is an address in numbers."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def split_address(address: str) -> SplitResult:
    """Take an address of the web apart; one that is none has only empty parts."""
    try:
        return urlsplit(address)
    except ValueError:
        return urlsplit("")


class Door:
    """Lets in whoever asks for this page by one of its own names, and was sent by no other page.

    A browser says by ``Origin`` which page a request comes from, and by ``Host`` which name it has looked up: a page elsewhere
    can have its own name lead here (DNS rebinding). A server that listens at all addresses goes by any of them in numbers,
    which no name can be made to look like.
    """

    def __init__(self, host: str):
        self._names = {*LOOPBACK, host.lower()}
        self._everywhere = host in EVERYWHERE
        if self._everywhere:
            self._names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def admits(self, hosts: list[str], origins: list[str]) -> bool:
        """Decide by the headers ``Host`` and ``Origin`` of a request; programs that are no browsers send no origin."""
        if len(hosts) != 1 or len(origins) > 1 or not self._knows(hosts[0]):
            return False
        return not origins or split_address(origins[0]).netloc.lower() == hosts[0].lower()

    def _knows(self, host: str) -> bool:
        """Tell whether a host, with or without a port, is a name of this server."""
        name = split_address(f"//{host}").hostname or ""
        return name in self._names or (self._everywhere and _is_address(name))


class NoMessageError(Exception):
    """What has come over a connection is no message of viser's."""


LOGGER = logging.getLogger("pellucid.viewer.connections")
LOGGER.addFilter(lambda record: record.msg != "opening handshake failed")  # by what is no request at all


@contextmanager
def guarded(door: Door) -> Iterator[None]:
    """Have the server that viser starts inside ask a door about every request, for pages and for their connections alike.

    A connection over which nonsense comes is closed with one line.
    """
    import websockets.asyncio.server as library
    from viser._messages import Message

    serve = library.serve
    # Types of what messages hold, which `check_messages` looks at:
    warnings.filterwarnings("ignore", r"(?s)\[viser\] .* does not match", module=r"viser\.infra\._messages")

    def guarded_serve(
        handler: Callable[..., Any], *arguments: Any, process_request: Callable[..., Any], **options: Any
    ) -> Any:
        async def handle(connection: Any) -> None:
            receive = connection.recv

            async def receive_message() -> Any:
                raw = await receive()
                try:
                    Message.deserialize(raw)
                except Exception as error:  # whatever it is, viser could not have read it either
                    raise NoMessageError(f"{type(error).__name__}: {error}") from None
                return raw

            connection.recv = receive_message
            try:
                await handler(connection)
            except NoMessageError as error:
                warn(f"A page has sent what is no message; its connection is closed ({error}).")
                await connection.close(1007)

        def process(connection: Any, request: Any) -> Any:
            if door.admits(request.headers.get_all("Host"), request.headers.get_all("Origin")):
                return process_request(connection, request)
            return connection.respond(
                403, "This page is not for you: it was asked for by another name, or by another page.\n"
            )

        return serve(handle, *arguments, process_request=process, logger=LOGGER, **options)

    library.serve = guarded_serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = serve  # type: ignore[misc]


def check_messages(server: Any) -> None:
    """Have a server ignore messages that say what no page can: the controls go back to what they were."""
    from viser import _messages

    controls = server.gui._gui_input_handle_from_uuid

    def accept(message: Any) -> bool:
        try:
            if isinstance(message, _messages.GuiUpdateMessage):
                control = controls.get(message.uuid)
                return _fits(control._impl, message.updates) if control else set(message.updates) == {"value"}
            if isinstance(message, _messages.ViewerCameraMessage):
                return _is_view(message)
            if isinstance(message, _messages.TransformControlsUpdateMessage):
                return _are_numbers(message.position, 3, FARTHEST) and _are_numbers(message.wxyz, 4, FARTHEST)
        except (TypeError, ValueError, OverflowError):
            return False
        return True

    def put_back(message: Any) -> None:
        control = controls.get(getattr(message, "uuid", None))
        if control is not None:
            value = {"value": control._impl.value}
            server.gui._websock_interface.queue_message(_messages.GuiUpdateMessage(message.uuid, value))

    def check(handler: Any) -> None:
        handle = handler._handle_incoming_message

        async def checked(client: Any, message: Any) -> None:
            if accept(message):
                await handle(client, message)
            else:
                put_back(message)

        handler._handle_incoming_message = checked

    check(server._websock_server)
    server._websock_server._client_connect_cb.insert(0, check)


def _fits(control: Any, updates: dict[str, Any]) -> bool:
    """Tell whether a control can have a value: of its kind, within its limits, one of its choices."""
    if set(updates) != {"value"}:
        return False
    value, present, props = updates["value"], control.value, control.props
    if isinstance(present, bool):
        return isinstance(value, bool)
    if isinstance(present, str):
        return isinstance(value, str) and value in getattr(props, "options", ())
    limits = [getattr(props, name, None) for name in ("min", "max")]
    if type(props).__name__ == "GuiRgbProps":
        limits = [0, 255]
    low, high = (limit if limit is not None else end for limit, end in zip(limits, (-LARGEST, LARGEST), strict=True))
    count = len(present) if isinstance(present, tuple) else 1
    values = value if isinstance(present, tuple) else [value]
    if not _are_numbers(values, count, LARGEST):
        return False
    slack = 1e-6 * (1 + np.abs(values))  # of numbers that were rounded on their way
    return bool(np.all(values >= np.asarray(low) - slack) and np.all(values <= np.asarray(high) + slack))


def _are_numbers(values: Iterable[Any], count: int, largest: float) -> bool:
    """Tell whether there are so many numbers, none of them larger than the largest."""
    values = list(values)
    numbers = all(isinstance(value, Real) and not isinstance(value, bool) for value in values)
    return numbers and len(values) == count and bool(np.all(np.abs(np.array(values, float)) <= largest))


def _is_view(message: Any) -> bool:
    """Tell whether a camera can be: somewhere, looking somewhere else, through a window."""
    place, target, up = message.position, message.look_at, message.up_direction
    vectors = all(_are_numbers(vector, 3, FARTHEST) for vector in (place, target, up))
    if not (vectors and _are_numbers(message.wxyz, 4, FARTHEST) and _are_numbers([message.fov], 1, LARGEST)):
        return False
    window = (message.image_width, message.image_height)
    if not all(isinstance(n, int) and 0 <= n <= WIDEST for n in window):
        return False
    apart = np.linalg.norm(np.subtract(place, target)) > 0 and np.linalg.norm(up) > 0
    return bool(apart) and 1e-3 < message.fov < np.pi - 1e-3

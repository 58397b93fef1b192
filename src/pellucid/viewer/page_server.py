"""The exported page, served, with what needs Python: comparison with two-pass, scenes for Mitsuba, other meshes."""

from __future__ import annotations

import hmac
import json
import secrets
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs

from ..errors import PellucidError
from .guard import Door, is_loopback, split_address
from .page_session import PageSession

LARGEST_REQUEST = 1 << 20  # bytes


class PageServer(ThreadingHTTPServer):
    """Hands out the page of a session, and what it asks for.

    Where it listens beyond this machine, whoever asks has to know a token, which is in the address that is printed.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, host: str, port: int, session: PageSession):
        self.session, self.door = session, Door(host)
        self.token = "" if is_loopback(host) else secrets.token_urlsafe(16)
        self.address_family = 10 if ":" in host else 2
        super().__init__((host, port), Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of those who have gone before they were answered."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)

    def knows(self, token: str) -> bool:
        """Tell whether a token is the right one."""
        return hmac.compare_digest(token.encode(), self.token.encode())


class Handler(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """Hand out the page, or how far a comparison is."""
        place = split_address(self.path)
        token = parse_qs(place.query).get("token", [""])[0] if place.path == "/" else self._bearer()
        routes: dict[str, Callable[[], tuple[str, bytes]]] = {
            "/": self._page,
            "/comparison": lambda: _json(self.server.session.progress()),
            "/comparison/picture": lambda: ("application/octet-stream", self.server.session.picture()),
        }
        self._answer(routes.get(place.path), token)

    def do_POST(self) -> None:
        """Carry out what the page asks for."""
        session, place = self.server.session, split_address(self.path).path
        acts = {"/comparison": session.compare, "/stop": session.stop, "/scene": session.save, "/open": session.open}
        act = acts.get(place)
        size = self.headers.get("Content-Length", "")
        is_json = self.headers.get("Content-Type", "").split(";")[0] == "application/json"  # which no form can send
        if act is None or not is_json or not size.isdecimal() or int(size) > LARGEST_REQUEST:
            self.close_connection = True  # what was sent is not read
            return self._send(400, "text/plain", b"This is no request of the page.\n")
        body = self.rfile.read(int(size))
        self._answer(lambda: _json(act(_parsed(body))), self._bearer())

    def _bearer(self) -> str:
        return self.headers.get("Authorization", "").partition(" ")[2]

    def _page(self) -> tuple[str, bytes]:
        return "text/html; charset=utf-8", self.server.session.page().encode()

    def _answer(self, act: Callable[[], tuple[str, bytes]] | None, token: str) -> None:
        """Let in who may come in, and answer."""
        hosts, origins = (self.headers.get_all(name) or [] for name in ("Host", "Origin"))
        if not self.server.door.admits(hosts, origins) or not self.server.knows(token):
            text = (
                "This page is not for you: it was asked for by another name, by another page, or without its token.\n"
            )
            return self._send(403, "text/plain", text.encode())
        if act is None:
            return self._send(404, "text/plain", b"There is no such page.\n")
        try:
            self._send(200, *act())
        except PellucidError as error:
            self._send(422, *_json({"error": " ".join(str(error).split())}))
        except Exception as error:
            self._send(500, *_json({"error": f"Something went wrong: {error or type(error).__name__}"}))

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "Content-Security-Policy": "frame-ancestors 'none'",  # the rest is in the page
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *values: Any) -> None:
        """Say nothing about requests."""


def _json(value: Any) -> tuple[str, bytes]:
    return "application/json", json.dumps(value).encode()


def _parsed(body: bytes) -> Any:
    """Read JSON; what is none is nothing."""
    try:
        return json.loads(body)
    except (ValueError, RecursionError):
        return None

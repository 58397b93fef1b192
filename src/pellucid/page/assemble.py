"""The page as one file: modules, styles and data, under a Content-Security-Policy that knows them by their hashes."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from functools import cache
from importlib.resources import files
from typing import Any

from .scene import PageScene

WEB = files(__package__) / "web"
ENTRY = "main.js"

_IMPORT = re.compile(r'^import (?:\* as )?(?P<names>\{[^}]*\}|\w+) from "(?P<path>[^"]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?P<kind>const|class|(?:async )?function) (?P<name>\w+)", re.MULTILINE)

_COMMENT = re.compile(r"/\*\*.*?\*/|^ *//[^\n]*\n", re.MULTILINE | re.DOTALL)


@cache
def script() -> str:
    """Join the modules of the page, each behind those that it imports, to one script without comments.

    Browsers open no modules from ``file://``.
    """
    order: list[str] = []
    texts: dict[str, str] = {}

    def visit(path: str) -> None:
        if path in texts:
            return
        texts[path] = text = _COMMENT.sub("", (WEB / path).read_text(encoding="utf-8"))
        for match in _IMPORT.finditer(text):
            visit(_resolve(path, match["path"]))
        order.append(path)

    visit(ENTRY)
    joined = "\n".join(_enclosed(path, texts[path]) for path in order)
    return f'"use strict";\n(() => {{\nconst modules = {{}};\n{joined}}})();\n'


def _resolve(path: str, target: str) -> str:
    """Find the file that a module at ``path`` means by ``target``."""
    parts = path.split("/")[:-1]
    for part in target.split("/"):
        if part == "..":
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)


def _enclosed(path: str, text: str) -> str:
    """Turn a module into a function that is called at once, and what it exports into what that returns."""
    names = ", ".join(match["name"] for match in _EXPORT.finditer(text))
    text = _EXPORT.sub(r"\g<kind> \g<name>", text)
    text = _IMPORT.sub(lambda m: f'const {m["names"]} = modules["{_resolve(path, m["path"])}"];\n', text)
    return f'modules["{path}"] = (() => {{\n{text}return {{ {names} }};\n}})();\n'


def page(scene: PageScene, *, still: bytes = b"", command: str = "", served: bool = False) -> str:
    """Write the page.

    Parameters
    ----------
    scene : PageScene
    still : bytes
        A JPEG that is shown where the page cannot run.
    command : str
        What made the page.
    served : bool
        The page talks with the server that it comes from.
    """
    from ..citation import software_line

    styles, boot = ((WEB / name).read_text(encoding="utf-8") for name in ("page.css", "boot.js"))
    code = script()
    connect = "'self'" if served else "'none'"
    policy = (
        f"default-src 'none'; script-src {_hash(boot)} {_hash(code)}; style-src {_hash(styles)}; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    head = {**scene.head, "command": command, "credit": software_line(), "served": served}
    name = _escaped(str(scene.head["name"]))
    picture = f"data:image/jpeg;base64,{base64.b64encode(still).decode()}"
    values = {
        "POLICY": policy,
        "NAME": name,
        "STYLES": styles,
        "STILL": f'<img id="still" src="{picture}" alt="A picture of {name}">' if still else "",
        "HEAD": _json(head),
        "DATA": scene.data,
        "CODE": base64.b64encode(zlib.compress(code.encode(), 9)).decode(),
        "BOOT": boot,
    }
    text = (WEB / "page.html").read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda match: values[match[1]], text)


def _hash(text: str) -> str:
    """Name an inline script or style in a policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _json(value: Any) -> str:
    """Write JSON that ends no script element."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _escaped(text: str) -> str:
    """Write text into HTML."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")

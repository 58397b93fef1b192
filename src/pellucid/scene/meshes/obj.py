"""OBJ with its indices counted from the first vertex, as trimesh 5.2 needs them.

A negative index counts backwards from the vertices read so far; trimesh counts from the last vertex of the whole file, so
that files in blocks lose all blocks but the last.
"""

from __future__ import annotations

import re
from bisect import bisect_left

_RELATIVE = re.compile(r"^[ \t]*f[ \t].*[ \t/]-\d.*$", re.MULTILINE)
_KINDS = ("v", "vt", "vn")


def absolute_indices(text: str) -> str:
    """Rewrite the negative indices of an OBJ file as positive ones."""
    text = text.replace("\\\r\n", " ").replace("\\\n", " ")
    if not _RELATIVE.search(text):
        return text
    starts = [[m.start() for m in re.finditer(rf"^[ \t]*{kind}[ \t]", text, re.MULTILINE)] for kind in _KINDS]

    def face(line: re.Match[str]) -> str:
        so_far = [bisect_left(places, line.start()) for places in starts]
        corners = (
            "/".join(
                str(so_far[k] + 1 + int(index)) if index.startswith("-") else index
                for k, index in enumerate(corner.split("/"))
            )
            for corner in line[0].split()[1:]
        )
        return "f " + " ".join(corners)

    return _RELATIVE.sub(face, text)

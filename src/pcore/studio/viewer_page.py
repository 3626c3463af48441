"""One HTML file that shows a recording of splats: no server, no network."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files

import torch

from pcore.errors import InputError
from pcore.geometry.orbit import fitting_distance
from pcore.geometry.point_cloud import extent_of
from pcore.studio.guard import HEADERS, REFUSED, WELCOME, Guard
from pcore.studio.packing import pack
from pcore.studio.ports import SERVER, check_port, family_of
from pcore.studio.recording import Recording

LARGEST = 5_000_000
"""Bytes of a page."""
ANGLE = 40.0
"""Vertical field of view, degrees; as `orbit_around` takes it for square pictures."""
_ROOM = 0.99
"""Share of the limit that is planned with."""


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page and what had to be left out of it, a sentence each."""

    content: bytes
    notes: tuple[str, ...]


def viewer_page(
    recording: Recording, *, title: str, seconds: float = 4.0, limit: int = LARGEST
) -> Page:
    """Make the page.

    Args:
        recording: what it shows.
        title: of the page, shown in its corner.
        seconds: from the first moment to the last.
        limit: most bytes of it.

    Raises:
        InputError: a limit that leaves no room.
    """
    room = int(_ROOM * (limit - len(_filled("{}", "", title).encode())) * 3 / 4) - 4096
    if room < 1:
        raise InputError(f"page: expected a limit of at least 100 kB, got {limit:,} bytes")
    packed = pack(recording, room)
    everywhere = torch.cat([one.means for one in recording.moments])
    low, high = extent_of(everywhere)
    center = (low + high) / 2
    head = packed.head | {
        "center": center.tolist(),
        "distance": fitting_distance(everywhere, center, math.radians(ANGLE)),
        "angle": ANGLE,
        "seconds": seconds,
    }
    data = base64.b64encode(packed.data).decode("ascii")
    return Page(content=_filled(json.dumps(head), data, title).encode(), notes=packed.notes)


def _filled(head: str, data: str, title: str) -> str:
    page = files("pcore.studio").joinpath("page")
    parts = {
        "@TITLE@": html.escape(title),
        "@STYLE@": page.joinpath("viewer.css").read_text(encoding="utf-8"),
        "@HEAD@": head,
        "@SCRIPT@": page.joinpath("viewer.js").read_text(encoding="utf-8"),
        "@DATA@": data,
    }
    text = page.joinpath("viewer.html").read_text(encoding="utf-8")
    return re.sub("|".join(parts), lambda mark: parts[mark.group()], text)


def page_server(guard: Guard, content: bytes) -> ThreadingHTTPServer:
    """Make a server of a page; `serve_forever` runs it, another thread may `shutdown` it.

    Args:
        guard: who may see it, and where it listens.
        content: the page.

    Raises:
        InputError: its port is taken.
    """

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            """Answer with the page, or say no."""
            headers = {name.lower(): value for name, value in self.headers.items()}
            if guard.refusal(headers, self.path, socket=False) is not None:
                self._answer(REFUSED, b"refused\n", kind="text/plain")
            elif guard.brings_token(self.path):
                self._answer(200, WELCOME, cookie=guard.set_cookie)
            elif self.path == "/":
                self._answer(200, content)
            else:
                self._answer(404, b"not found\n", kind="text/plain")

        def version_string(self) -> str:
            return SERVER

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing."""

        def _answer(
            self, status: int, body: bytes, *, kind: str = "text/html", cookie: str | None = None
        ) -> None:
            self.send_response(status)
            for name, value in HEADERS:
                self.send_header(name, value)
            if cookie is not None:
                self.send_header("Set-Cookie", cookie)
            self.send_header("Content-Type", f"{kind}; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    check_port(guard.host, guard.port)

    class Server(ThreadingHTTPServer):
        address_family = family_of(guard.host, guard.port)

    return Server((guard.host, guard.port), Handler)

"""One HTML file that shows a recording of splats: no server, no network."""

from __future__ import annotations

import base64
import html
import json
import math
import re
from dataclasses import dataclass
from importlib.resources import files

import torch

from pcore.errors import InputError
from pcore.geometry.orbit import fitting_distance
from pcore.geometry.point_cloud import extent_of
from pcore.studio.packing import pack
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
    everywhere = torch.cat([one.means[recording.body] for one in recording.moments])
    low, high = extent_of(everywhere)
    center = (low + high) / 2
    head = packed.head | {
        "center": center.tolist(),
        "axes": recording.axes.T.tolist(),
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

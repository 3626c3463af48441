"""A drawing of cameras around an object, from above and from the side, as SVG."""

from __future__ import annotations

import html
import math
from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from pcore.capture.coverage import Coverage
from pcore.data.scene import View
from pcore.geometry.object_region import Region

_SIZE, _EDGE = 320.0, 26.0
_HEAD = 9.0
"""Length of a camera in the drawing."""


def camera_drawing(
    views: Sequence[View],
    region: Region,
    cover: Coverage,
    *,
    odd: Collection[int] = (),
    lines: Sequence[tuple[int, int]] = (),
) -> str:
    """Two drawings side by side; colours are the page's (`--accent`, `--ink`, `--rule`, `--bad`).

    Args:
        views: whose cameras are drawn; their names show when the pointer rests on them.
        region: of the object, the circle in the middle.
        cover: says which way is up and where the largest gap is.
        odd: numbers of views that are drawn in the colour of warnings.
        lines: pairs of views that are joined by a line in that colour.
    """
    up = cover.up
    side, ahead = _across(up)
    places = torch.stack([view.camera.center for view in views]) - region.center
    looks = torch.stack([-view.camera.world_from_camera[:3, 2] for view in views])
    frames = (("from above", side, ahead), ("from the side", side, up))
    reach = 1.08 * float(places.norm(dim=-1).max())
    scale = (_SIZE / 2 - _EDGE) / max(reach, region.radius)
    parts: list[str] = []
    for column, (title, x, y) in enumerate(frames):
        middle = (_SIZE * (column + 0.5), _SIZE / 2 + 8)
        parts.append(
            f'<text x="{middle[0]:.0f}" y="14" text-anchor="middle" class="t">{title}</text>'
        )
        if column == 0:
            parts.append(_gap(cover, middle, scale * reach))
        parts.append(
            f'<circle cx="{middle[0]:.1f}" cy="{middle[1]:.1f}" '
            f'r="{max(2.0, scale * region.radius):.1f}" class="o"/>'
        )
        flat = scale * torch.stack([places @ x, -(places @ y)], dim=-1) + torch.tensor(middle)
        turn = torch.stack([looks @ x, -(looks @ y)], dim=-1)
        parts += [_line(flat[a], flat[b]) for a, b in lines]
        parts += [_camera(flat[i], turn[i], view.name, i in odd) for i, view in enumerate(views)]
    width = 2 * _SIZE
    return (
        f'<svg viewBox="0 0 {width:.0f} {_SIZE + 10:.0f}" role="img" class="cameras" '
        f'aria-label="{len(views)} cameras around the object, from above and from the side">'
        f"{''.join(parts)}</svg>"
    )


def _across(up: Tensor) -> tuple[Tensor, Tensor]:
    """The axes that `coverage` counts azimuth from."""
    side = torch.eye(3)[int(up.abs().argmin())]
    side = side - (side @ up) * up
    side = side / side.norm()
    return side, torch.linalg.cross(up, side)


def _gap(cover: Coverage, middle: tuple[float, float], radius: float) -> str:
    """The sector without cameras, where it is wide."""
    if cover.gap < 45:
        return ""
    ends = [cover.gap_middle + sign * cover.gap / 2 for sign in (-1, 1)]
    corners = [
        (
            middle[0] + radius * math.cos(math.radians(end)),
            middle[1] - radius * math.sin(math.radians(end)),
        )
        for end in ends
    ]
    (x0, y0), (x1, y1) = corners
    large = int(cover.gap > 180)
    return (
        f'<path class="g" d="M{middle[0]:.1f} {middle[1]:.1f} L{x0:.1f} {y0:.1f} '
        f'A{radius:.1f} {radius:.1f} 0 {large} 0 {x1:.1f} {y1:.1f} Z">'
        f"<title>no camera in {cover.gap:.0f} degrees</title></path>"
    )


def _camera(place: Tensor, look: Tensor, name: str, odd: bool) -> str:
    """A triangle whose tip is the camera's place and which opens along its view."""
    x, y = place.tolist()
    along = look * _HEAD
    wide = torch.stack([-look[1], look[0]]) * _HEAD * 0.45
    # Seen along its axis a camera is a dot.
    if float(look.norm()) < 0.15:
        wide, along = torch.tensor([1.5, 0.0]), torch.tensor([0.0, 3.0])
    corners = [place, place + along + wide, place + along - wide]
    points = " ".join(f"{float(c[0]):.1f},{float(c[1]):.1f}" for c in corners)
    kind = "c b" if odd else "c"
    return (
        f'<g><polygon points="{points}" class="{kind}"/><circle cx="{x:.1f}" cy="{y:.1f}" r="1.6" '
        f'class="{kind}"/><title>{html.escape(name)}</title></g>'
    )


def _line(one: Tensor, other: Tensor) -> str:
    (x0, y0), (x1, y1) = one.tolist(), other.tolist()
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" class="l"/>'

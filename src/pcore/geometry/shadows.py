"""Which light from far away reaches points past the others: shadow maps made of points."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.rays import perpendicular

_CELL = 0.6
"""Side of the cells of a shadow map in spacings; a point covers nine of them."""
_THICK = 3.5
"""In spacings: points of a surface lie in a shell, and do not hide what is less deep below it."""
_FINEST = 1024
"""Cells along the longest side of a map at most, so that a stray point does not cost a lot."""
_ELEMENTS = 2_000_000


@torch.no_grad()
def unshadowed(points: Tensor, directions: Tensor, spacing: float) -> Tensor:
    """How much of the light from D directions reaches N points, (N, D) in [0, 1].

    Across every direction lies a grid of cells. A point covers its cell and the eight around it; of
    the nine cells around a point those count in which nothing is nearer to the light by more than
    the thickness of a surface.

    Args:
        points: (N, 3) world units.
        directions: (D, 3) unit, towards where the light comes from.
        spacing: of the points, from `pcore.geometry.visibility.cloud_spacing`, world units.
    """
    directions = directions.to(points)
    shares = points.new_ones(len(points), len(directions))
    lower, upper = points.amin(dim=0), points.amax(dim=0)
    side = float((upper - lower).norm())
    if side == 0 or spacing <= 0:
        return shares
    spacing = max(spacing, side / _FINEST / _CELL)
    step = _CELL * spacing
    cells = (side / step + 4) ** 2
    together = max(1, int(_ELEMENTS / max(cells, len(points))))
    points = points - (lower + upper) / 2
    for part in torch.arange(len(directions)).split(together):
        some = directions[part]
        shares[:, part.to(points.device)] = _lit(points, some, step, _THICK * spacing).T
    return shares


def _lit(points: Tensor, directions: Tensor, step: float, thick: float) -> Tensor:
    """Share (D, N) of the cells around points that nothing covers from directions (D, 3)."""
    right = perpendicular(directions)
    up = torch.linalg.cross(directions, right)
    height = directions @ points.T
    column, row = ((one @ points.T / step).floor().long() for one in (right, up))
    # One cell of nothing around, which points at the rim cover and look at.
    column, row = column - column.min() + 1, row - row.min() + 1
    size = int(column.max()) + 2, int(row.max()) + 2
    flat = column * size[1] + row
    top = height.new_full((len(directions), size[0] * size[1]), -torch.inf)
    top.scatter_reduce_(1, flat, height, "amax")
    top = F.max_pool2d(top.unflatten(1, size).unsqueeze(1), 3, stride=1, padding=1).flatten(1)
    lit = torch.zeros_like(height)
    for along in (-1, 0, 1):
        for across in (-1, 0, 1):
            lit += top.gather(1, flat + along * size[1] + across) <= height + thick
    return lit / 9

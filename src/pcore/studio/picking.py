"""Which points of an object a pointer means: one under it, or those in a rectangle."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.visibility import visible_from

_BESIDE = 3.0
"""Spacings that a point may lie beside the ray."""
_BEHIND = 2.0
"""How many times dearer a spacing beside the ray is than one farther away along it."""
_FAINT = 0.1


def point_under(
    points: Tensor, origin: Tensor, direction: Tensor, *, spacing: float, opacities: Tensor
) -> int | None:
    """Number of the point that a ray meets first; None where it meets none.

    Args:
        points: (N, 3) world units.
        origin: (3,) of the ray, world units.
        direction: (3,) of the ray, of any length.
        spacing: how far points are apart, world units.
        opacities: (N,); what is nearly transparent cannot be meant.
    """
    unit = direction.to(points) / direction.norm()
    offset = points - origin.to(points)
    along = offset @ unit
    beside = (offset - along[:, None] * unit).norm(dim=1)
    near = (along > 0) & (beside < _BESIDE * spacing) & (opacities > _FAINT)
    if not bool(near.any()):
        return None
    # Among those in front the one nearest to the ray: of two layers always the first.
    first = along[near].min()
    front = near & (along < first + 4 * spacing)
    cost = along + _BEHIND * beside
    return int(torch.where(front, cost, torch.inf).argmin())


def points_within(
    points: Tensor,
    camera: Camera,
    lower: tuple[float, float],
    upper: tuple[float, float],
    *,
    spacing: float,
    visible: bool = True,
) -> Tensor:
    """Tell which points lie in a rectangle of a picture.

    Args:
        points: (N, 3) world units.
        camera: of the picture.
        lower: left and upper edge as shares of the picture.
        upper: right and lower edge.
        spacing: how far points are apart, world units.
        visible: leave out those that other points cover.

    Returns:
        (N,) bool.
    """
    column, row, depth = camera.project(points)
    x, y = column / camera.width, row / camera.height
    inside = (depth > 0) & (x >= lower[0]) & (x <= upper[0]) & (y >= lower[1]) & (y <= upper[1])
    return inside & visible_from(points, camera, spacing) if visible else inside

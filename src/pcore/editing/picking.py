"""From a place in a picture to a place on the object."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.editing.state import EditState
from pcore.geometry.camera import Camera
from pcore.geometry.visibility import cloud_spacing
from pcore.render.image import Image

_SOLID = 0.5
_LAYER = 2.0
"""Spacings from the first point of a ray within which others may be the nearest to it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hit:
    """What lies under a pixel.

    Attributes:
        place: (3,) on the surface as it is now, world units: where regions and handles of the next
            edit are.
        point: number of the nearest point.
        rest: (3,) the same place before any edit: where regions that are frozen are.
        alpha: opacity of the picture there; 1 without one.
    """

    place: Tensor
    point: int
    rest: Tensor
    alpha: float = 1.0


def pick(
    state: EditState,
    camera: Camera,
    column: float,
    row: float,
    *,
    picture: Image | None = None,
    spacing: float | None = None,
) -> Hit | None:
    """Find what of an object lies under a pixel; None where nothing does.

    Args:
        state: of the session.
        camera: who looks.
        column: pixels from the left of the picture.
        row: pixels from its top.
        picture: what the camera saw of this state, which is exact; None goes by the points alone.
        spacing: of the points, `cloud_spacing`; None measures it, which takes longer than the rest.
    """
    points, alpha = state.points.detach().cpu(), 1.0
    if picture is None:
        found = _by_points(points, camera, column, row, spacing)
        if found is None:
            return None
        place, point = found
    else:
        x, y = int(column), int(row)
        if not (0 <= x < camera.width and 0 <= y < camera.height):
            return None
        alpha, place = float(picture.alpha[y, x]), picture.surface[y, x].detach().cpu()
        if alpha < _SOLID or not bool(place.isfinite().all()):
            return None
        place = place.to(points)
        point = int((points - place).square().sum(dim=1).argmin())
    back = torch.linalg.pinv(state.bound.linear[point])
    beside = back @ (place.double() - state.bound.setting.points[point])
    rest = (state.bound.setting.rest[point] + beside).to(points)
    return Hit(place=place, point=point, rest=rest, alpha=alpha)


def _by_points(
    points: Tensor, camera: Camera, column: float, row: float, spacing: float | None
) -> tuple[Tensor, int] | None:
    """The place of a ray beside the foremost points that it passes, and the nearest of those."""
    origin, direction = ray_through(camera, column, row)
    offset = points - origin.to(points)
    along = offset @ direction.to(points)
    across = (offset - along.unsqueeze(1) * direction.to(points)).norm(dim=1)
    width = cloud_spacing(points) if spacing is None else spacing
    near = (across < width) & (along > 0)
    if not bool(near.any()):
        return None
    first = float(along[near].min())
    layer = near & (along < first + _LAYER * width)
    point = int(across.masked_fill(~layer, torch.inf).argmin())
    return origin.to(points) + along[point] * direction.to(points), point


def ray_through(camera: Camera, column: float, row: float) -> tuple[Tensor, Tensor]:
    """Origin (3,) and unit direction (3,), world units, of the ray through a place of a picture."""
    moved = camera.cropped(int(column), int(row), 1, 1)
    places = torch.tensor([[column - int(column), row - int(row)]])
    ray = moved.rays(places=places)
    return ray.origins.reshape(3), ray.directions.reshape(3)

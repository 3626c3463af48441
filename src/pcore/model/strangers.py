"""Occlusion between parts that an edit brought before one another.

Attention has learned from photos which point of a ray hides which. It knows nothing of points that
never met one ray at rest: an arm that was lowered and the hip behind it. Seen from the hip's points
the ray of the rest state passes nowhere near the arm. Such points are strangers to the foremost
point of the ray, and the order along the ray decides: the foremost and its like are attended to
first, the strangers get what light those let through (docs/guide/deformation-aware.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended

_FAR = 1.5
"""In cut-offs: a rest ray farther than that from the foremost point never met it. Chosen on poses
of our own; 1 and 2 gave the same within 0.02 dB."""
_AWAY = 4.0
"""In cut-offs: where points that are to be passed over are put, beside their ray."""
OPAQUE = 0.97
"""Behind such an opacity strangers are not looked at."""
_LEAST = 1e-9


@torch.no_grad()
def strangers(
    positions: Tensor, rest: Tensor, rays: RayBundle, seen: RayBundle, cutoff: float
) -> Tensor:
    """Tell which neighbours of a ray never met it together with the foremost of them.

    Args:
        positions: (R, k, 3) deformed neighbours, world units.
        rest: (R, k, 3) the same at rest.
        rays: (R,) rays of the deformed scene.
        seen: (R, k) the same at rest, as each neighbour sees them.
        cutoff: distance beyond which a point gets no attention, world units.

    Returns:
        (R, k) bool; never the foremost itself.
    """
    origin, direction = (one.unsqueeze(1).unbind(dim=-1) for one in vars(rays).values())
    depth = _dot(_minus(positions.unbind(dim=-1), origin), direction)
    # What lies behind the origin hides nothing.
    answers = (_squared_distance(rest, seen) <= cutoff**2) & (depth > 0)
    depth = torch.where(answers, depth, torch.inf)
    nearest, first = depth.min(dim=1, keepdim=True)
    foremost = rest.take_along_dim(first.unsqueeze(-1), dim=1)
    apart = _squared_distance(foremost, seen) > (_FAR * cutoff) ** 2
    return apart & (depth < torch.inf) & (depth > nearest)


def without(rest: Tensor, seen: RayBundle, left_out: Tensor, cutoff: float) -> RayBundle:
    """Rays (R, k) of the rest state that pass some neighbours (R, k) so far that they are mute.

    Args:
        rest: (R, k, 3) neighbours at rest.
        seen: (R, k) rays as each neighbour sees them.
        left_out: (R, k) bool.
        cutoff: see `strangers`.
    """
    some = torch.nonzero(left_out.flatten()).squeeze(-1)
    direction = seen.directions.flatten(0, 1)[some]
    least = torch.nn.functional.one_hot(direction.abs().argmin(dim=-1), 3).to(direction)
    beside = torch.nn.functional.normalize(torch.linalg.cross(direction, least), dim=-1)
    away = rest.flatten(0, 1)[some] + _AWAY * cutoff * beside
    origins = seen.origins.flatten(0, 1).index_copy(0, some, away).view_as(seen.origins)
    return RayBundle(origins=origins, directions=seen.directions)


def behind(front: Attended, rows: Tensor, back: Attended) -> Attended:
    """Put what strangers say behind what the foremost points say.

    Args:
        front: (R,) rays without the strangers.
        rows: (M,) the rays among them that have strangers to be seen.
        back: (M,) these rays with the strangers alone.

    Returns:
        (R,) rays; opacity and weights as of two layers, one behind the other.
    """
    first = 1 - front.background[rows]
    second = front.background[rows] * (1 - back.background)
    opacity = first + second
    # Where neither layer answers the first one's values stay.
    share = torch.where(opacity > _LEAST, second / opacity.clamp_min(_LEAST), 0.0)

    def mixed(name: str) -> Tensor:
        here, there = getattr(front, name), getattr(back, name)
        part = share.reshape(-1, *[1] * (here.dim() - 1))
        return here.index_copy(0, rows, (1 - part) * here[rows] + part * there)

    layered = {name: mixed(name) for name in ("features", "weights", "surface", "behind")}
    return replace(front, background=front.background.index_copy(0, rows, 1 - opacity), **layered)


_Vector = Sequence[Tensor]
"""x, y and z by themselves: time goes into memory, and (R, k) is a third of (R, k, 3)."""


def _squared_distance(points: Tensor, rays: RayBundle) -> Tensor:
    """Squared distance (R, k) of points (R, k or 1, 3) from rays (R, k)."""
    offset = _minus(points.unbind(dim=-1), rays.origins.unbind(dim=-1))
    along = _dot(offset, rays.directions.unbind(dim=-1))
    return _dot(offset, offset) - along * along


def _minus(a: _Vector, b: _Vector) -> _Vector:
    return [one - other for one, other in zip(a, b, strict=True)]


def _dot(a: _Vector, b: _Vector) -> Tensor:
    return torch.addcmul(torch.addcmul(a[0] * b[0], a[1], b[1]), a[2], b[2])

"""Opacity where an edit lays the inside of an object open.

A line through a closed object is opaque from either end. Attention has learned opacity from the
outside only: where an arm that was lifted leaves a gap in the shoulder, a ray enters the body, and
the points of its far side, which no photo has shown from within, may not answer. Such a line is
looked at from its other end (docs/concepts/deformation-aware-rays.md).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.attention import Attended

_OPAQUE = 0.5
"""Opacity from which on a line meets something."""
_CLOSE = 0.25
"""In cut-offs: a ray that passes no point closer than that passes the object by. Chosen, as is the
opacity, on held-out deformations and on poses of our own (ADR 5)."""


@torch.no_grad()
def unanswered(
    attended: Attended, neighbours: Tensor, cloud: PointCloud, rays: RayBundle, cutoff: float
) -> Tensor:
    """Indices (M,) of the rays that pass close to points and see through them.

    Args:
        attended: what R rays met.
        neighbours: (R, k) indices into the cloud.
        cloud: deformed points.
        rays: (R,) rays, world units.
        cutoff: distance beyond which a point gets no attention, world units.
    """
    answered = attended.weights.sum(dim=-1) > 0
    rows = torch.nonzero(answered & (attended.background > 1 - _OPAQUE)).squeeze(-1)
    if len(rows) == 0:
        return rows
    some = rays[rows]
    _, across = some[:, None].beside(cloud.positions[neighbours[rows]])
    squared = across.square().sum(dim=-1).amin(dim=1)
    middle, radius = cloud.sphere
    outside = (some.origins - middle).norm(dim=-1) > radius
    return rows[(squared <= (_CLOSE * cutoff) ** 2) & outside]


def turned(rays: RayBundle, cloud: PointCloud) -> RayBundle:
    """The same lines (M,) from their other ends, as far behind the cloud's middle as before it."""
    ahead = ((cloud.sphere[0] - rays.origins) * rays.directions).sum(dim=-1, keepdim=True)
    length = 2 * ahead.clamp_min(cloud.sphere[1])
    return RayBundle(origins=rays.origins + length * rays.directions, directions=-rays.directions)


def opaque(back: Attended) -> Tensor:
    """(M,) bool, which lines meet something from their other ends."""
    return back.background < 1 - _OPAQUE


def replaced(met: Attended, rows: Tensor, back: Attended, solid: Tensor) -> Attended:
    """What rays met, with some rows (K,) replaced by the K solid ones (M,) of `back`."""
    parts = {
        name: values.index_copy(0, rows, getattr(back, name)[solid])
        for name, values in vars(met).items()
    }
    return replace(met, **parts)

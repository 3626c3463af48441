"""Occlusion between parts that an edit brought before one another.

Attention has learned from photos which point of a ray hides which. It knows nothing of points that
never met one ray at rest: an arm that was lowered and the hip behind it. Seen from the hip's points
the ray of the rest state passes nowhere near the arm. Such points are strangers to the foremost
point of the ray, and the order along the ray decides: the foremost and its like are attended to
first, the strangers get what light those let through (docs/concepts/deformation-aware-rays.md).
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from pcore.kernels.ray_layers import LayerRules
from pcore.model.attention import Attended

_CLOSE = 0.2
"""In cut-offs, about as far as the points of `tiny` are apart: a ray that meets a surface has a
point of it so near, one that passes its rim by seldom has."""
_APART = 0.5
"""In cut-offs: a ray that passes the foremost point by more never met it. Both chosen on poses of
our own (ADR 5)."""
OPAQUE = 0.97
"""Behind such an opacity strangers are not looked at."""
_LEAST = 1e-9


def layer_rules(cutoff: float) -> LayerRules:
    """What tells strangers, for a distance (world units) beyond which a point gets no attention."""
    return LayerRules(close=_CLOSE * cutoff, apart=_APART * cutoff, cutoff=cutoff)


def behind(
    front: Attended, neighbours: Tensor, rows: Tensor, back: Attended, strangers: Tensor
) -> tuple[Attended, Tensor]:
    """Put what strangers say behind what the foremost points say.

    Args:
        front: (R,) rays without the strangers.
        neighbours: (R, k) indices of the points they met.
        rows: (M,) the rays among them that have strangers to be seen.
        back: (M,) these rays with the strangers alone.
        strangers: (M, k) indices of those.

    Returns:
        (R,) rays, with opacity, features and surface of two layers, one behind the other; and
        indices (R, k) of the points that have the weights: of both layers those with the greatest,
        which share what their layer has.
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

    k = neighbours.shape[1]
    part = share.unsqueeze(1)
    both = torch.cat([(1 - part) * front.weights[rows], part * back.weights], dim=1)
    kept, place = both.topk(k, dim=1)
    layer = (place >= k).long()
    # What the points of a layer that are left out had goes to those that stay.
    had = both.unflatten(1, (2, k)).sum(dim=2)
    left = torch.zeros_like(had).scatter_add(1, layer, kept)
    weights = kept * (had / left.clamp_min(torch.finfo(kept.dtype).tiny)).gather(1, layer)
    weights = weights / weights.sum(1, keepdim=True).clamp_min(_LEAST)
    met = torch.cat([neighbours[rows], strangers], dim=1).gather(1, place)
    layered = {name: mixed(name) for name in ("features", "surface", "behind")}
    return replace(
        front,
        background=front.background.index_copy(0, rows, 1 - opacity),
        weights=front.weights.index_copy(0, rows, weights),
        **layered,
    ), neighbours.index_copy(0, rows, met)

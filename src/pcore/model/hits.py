"""What rays hit: the points, and what attention makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_LEAST = 1e-9


@dataclass(frozen=True, kw_only=True)
class Hits:
    """What R rays hit; a ray that hits nothing has weights of 0 and all background.

    Attributes:
        neighbours: (R, k) indices of points.
        weights: (R, k) weights of the points, renormalised to sum to one (zero where no point
            is within the cut-off).
        background: (R,) attention that the background keeps; 1 minus it is the opacity.
        features: (R, C) weighted values.
        centroid: (R, 3) weighted positions, world units (paper: surface point s_j = sum w p).
        spread: (R,) weighted mean squared distance along the ray from the first of the points:
            large where the back of the object shows through. No gradient to the positions.
    """

    neighbours: Tensor
    weights: Tensor
    background: Tensor
    features: Tensor
    centroid: Tensor
    spread: Tensor

    @property
    def mask(self) -> Tensor:
        """(R,) bool, which rays hit a point."""
        return self.weights.sum(dim=-1) > 0

    def __getitem__(self, index: Tensor) -> Hits:
        """Return what the rays of an index or a mask hit."""
        return Hits(**{name: values[index] for name, values in vars(self).items()})

    def with_rows(self, ray_of_row: Tensor, rows: Hits) -> Hits:
        """Return the same where some rays (M,) hit something else, given by M rows."""
        return Hits(
            **{
                name: values.index_copy(0, ray_of_row, getattr(rows, name))
                for name, values in vars(self).items()
            }
        )

    def spread_over(self, nearest: Tensor, ray_of_row: Tensor) -> Hits:
        """Return hits of R rays, M of which these are; the others are pure background.

        Args:
            nearest: (R, k) points that stand for the neighbours of the others.
            ray_of_row: (M,) the rays of these.
        """
        if len(ray_of_row) == len(nearest):
            return self
        blank = {
            name: values.new_full((len(nearest), *values.shape[1:]), float(name == "background"))
            for name, values in vars(self).items()
        }
        return Hits(**{**blank, "neighbours": nearest}).with_rows(ray_of_row, self)


def composite_over(front: Hits, ray_of_back: Tensor, back: Hits) -> Hits:
    """Put what some rays hit behind what all hit first.

    Args:
        front: (R,) rays without the layer behind.
        ray_of_back: (M,) the rays that have one to be seen.
        back: (M,) that layer alone.

    Returns:
        (R,) rays, with opacity, features and centroid of two layers, one behind the other. Of the
        points of both layers those with the greatest weights are kept, which share what their layer
        has.
    """
    before = front[ray_of_back]
    first = 1 - before.background
    second = before.background * (1 - back.background)
    opacity = first + second
    # Where neither layer answers the first one's values stay.
    share = torch.where(opacity > _LEAST, second / opacity.clamp_min(_LEAST), 0.0)

    def mixed(here: Tensor, there: Tensor) -> Tensor:
        part = share.reshape(-1, *[1] * (here.dim() - 1))
        return (1 - part) * here + part * there

    neighbours, weights = _greatest(before, back, share)
    both = Hits(
        neighbours=neighbours,
        weights=weights,
        background=1 - opacity,
        features=mixed(before.features, back.features),
        centroid=mixed(before.centroid, back.centroid),
        spread=mixed(before.spread, back.spread),
    )
    return front.with_rows(ray_of_back, both)


def _greatest(front: Hits, back: Hits, share: Tensor) -> tuple[Tensor, Tensor]:
    """Points (M, k) of two layers with the greatest weights (M, k), by the back's share (M,)."""
    k, part = front.weights.shape[1], share.unsqueeze(1)
    both = torch.cat([(1 - part) * front.weights, part * back.weights], dim=1)
    kept, slot = both.topk(k, dim=1)
    layer = (slot >= k).long()
    # What the points of a layer that are left out had goes to those that stay.
    had = both.unflatten(1, (2, k)).sum(dim=2)
    left = torch.zeros_like(had).scatter_add(1, layer, kept)
    weights = kept * (had / left.clamp_min(torch.finfo(kept.dtype).tiny)).gather(1, layer)
    weights = weights / weights.sum(1, keepdim=True).clamp_min(_LEAST)
    return torch.cat([front.neighbours, back.neighbours], dim=1).gather(1, slot), weights

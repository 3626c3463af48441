"""Anchors: few points of a cloud that stand evenly for all of it."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.neighbours import as_points
from pcore.validation import check_count

ANCHORS = 128
"""How many anchors stand for a cloud (paper: M)."""


def farthest_points(points: Tensor, count: int, *, seed: int = 0) -> Tensor:
    """Farthest point sampling: each next point is the one farthest from those already chosen.

    The first is drawn from the seed. Equal distances go to the lower index, so that the same
    points and seed give the same choice everywhere.

    Args:
        points: (N, 3) world units.
        count: how many to choose (paper: M = 128).
        seed: of the first point.

    Returns:
        (count,) int64 indices into the points, in the order of choice, no two of one place.

    Raises:
        InputError: another shape, numbers that are not finite, or fewer than `count` places.
    """
    check_count("anchors: count", count)
    places = torch.from_numpy(as_points(points))
    if len(places) < count:
        raise InputError(
            f"anchors: expected at least {count} points to choose from, got {len(places)}; "
            "ask for fewer anchors"
        )
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.empty(count, dtype=torch.int64)
    chosen[0] = torch.randint(len(places), (), generator=generator)
    squared = (places - places[chosen[0]]).square().sum(dim=1)
    for index in range(1, count):
        farthest = int(squared.argmax())
        if float(squared[farthest]) == 0.0:
            raise InputError(
                f"anchors: expected at least {count} different places, got {index}; "
                "ask for fewer anchors"
            )
        chosen[index] = farthest
        squared = torch.minimum(squared, (places - places[farthest]).square().sum(dim=1))
    return chosen

"""Colours of places on a surface, out of pictures of it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.geometry.neighbours import nearest
from pcore.render.surfel_fit import Shown, colors_at

_AT_ONCE = 1 << 17


def surface_colors(
    places: Tensor, normals: Tensor, shown: Sequence[Shown], spacing: float
) -> Tensor:
    """Colours (N, 3) in [0, 1]: the median over the pictures that show a place.

    A place that fewer than two pictures show has the colour of the nearest one that they do; grey
    where they show none.

    Args:
        places: (N, 3) world units.
        normals: (N, 3) unit, outwards.
        shown: the pictures.
        spacing: half of how far a picture's depth may be off, world units.
    """
    parts = zip(places.split(_AT_ONCE), normals.split(_AT_ONCE), strict=True)
    found = [colors_at(some.float(), up.float(), shown, spacing) for some, up in parts]
    colors = torch.cat(found) if found else torch.zeros(0, 3)
    known = ~colors[:, 0].isnan()
    if not bool(known.any()):
        return torch.full_like(colors, 0.5)
    if not bool(known.all()):
        beside, _ = nearest(places[known], places[~known], 1)
        colors[~known] = colors[known][beside[:, 0]]
    return colors.clamp(0, 1)

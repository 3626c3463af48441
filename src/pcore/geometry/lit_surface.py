"""The surface over a cloud's points, and how its brightness changed since the photos.

Points have no extent and lie a little inside the object. Light falls on the surface, and changes
from one side of an edge to the other: a ray asks for it where it meets the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class LitSurface:
    """Small pieces of surface, one over each of N points.

    Attributes:
        places: (N, 3) world units.
        normals: (N, 3) unit, outwards; zero where none is known.
        gains: (N,) factor on the brightness that photos stored.
        beside: (N, K) int64, for every point the pieces with a normal that were nearest at rest;
            K is 0 where no normal is known.
        spacing: how far the points are apart, world units.
    """

    places: Tensor
    normals: Tensor
    gains: Tensor
    beside: Tensor
    spacing: float

    def __post_init__(self) -> None:
        parts = (self.places, self.normals, self.gains, self.beside)
        shapes = [tuple(one.shape) for one in parts]
        count = shapes[0][:1]
        expected = [(*count, 3), (*count, 3), count, (*count, *shapes[3][1:])]
        if shapes != expected or len(shapes[3]) != 2:
            raise InputError(
                "lit surface: expected places (N, 3), normals (N, 3), gains (N,) and neighbours "
                f"(N, K), got {', '.join(map(str, shapes))}"
            )

    def __len__(self) -> int:
        return len(self.places)

    def each(self, change: Callable[[Tensor], Tensor]) -> LitSurface:
        """Return the same with every tensor changed."""
        return LitSurface(
            places=change(self.places),
            normals=change(self.normals),
            gains=change(self.gains),
            beside=change(self.beside),
            spacing=self.spacing,
        )

    @property
    def finite(self) -> Tensor:
        """(N,) bool, which pieces have neither NaN nor infinity."""
        values = torch.cat([self.places, self.normals, self.gains.unsqueeze(1)], dim=1)
        return torch.isfinite(values).all(dim=1)

"""The surface over a cloud's points: a small plane over each, and how its brightness changed.

Points have no extent and lie a little inside the object. What a ray meets is the surface over them:
that is where it is deep, where light falls on it, and where both change at an edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Surfels:
    """Small pieces of surface, one over each of N points.

    Attributes:
        places: (N, 3) world units.
        normals: (N, 3) unit, outwards; zero where none is known.
        beside: (N, K) int64, for every point the pieces with a normal that were nearest at rest;
            K is 0 where no normal is known.
        spacing: how far the points are apart, world units.
        gains: (N,) factor on the brightness that photos stored; None leaves it as it was.
        deep: whether pictures are as deep as the skin; else as the points, as without one.
    """

    places: Tensor
    normals: Tensor
    beside: Tensor
    spacing: float
    gains: Tensor | None = None
    deep: bool = True

    def __post_init__(self) -> None:
        shapes = [tuple(one.shape) for one in (self.places, self.normals, self.beside)]
        count = shapes[0][:1]
        gains = count if self.gains is None else tuple(self.gains.shape)
        expected = [(*count, 3), (*count, 3), (*count, *shapes[2][1:])]
        if shapes != expected or len(shapes[2]) != 2 or gains != count:
            raise InputError(
                "skin: expected places (N, 3), normals (N, 3), neighbours (N, K) and gains (N,), "
                f"got {', '.join(map(str, [*shapes, gains]))}"
            )

    def __len__(self) -> int:
        return len(self.places)

    def each(self, change: Callable[[Tensor], Tensor]) -> Surfels:
        """Return the same with every tensor changed."""
        return replace(
            self,
            places=change(self.places),
            normals=change(self.normals),
            beside=change(self.beside),
            gains=None if self.gains is None else change(self.gains),
        )

    def to(self, device: torch.device | str) -> Surfels:
        """Return the same on a device."""
        return self.each(lambda tensor: tensor.to(device))

    @property
    def finite(self) -> Tensor:
        """(N,) bool, which pieces have neither NaN nor infinity."""
        values = [self.places, self.normals]
        if self.gains is not None:
            values.append(self.gains.unsqueeze(1))
        return torch.isfinite(torch.cat(values, dim=1)).all(dim=1)

"""A light that stands in the world: what it gives to surfaces at a place.

Light comes from D directions. Each has a distance: far away, the same for all of an object, or so
near that the sides of an object, and an object that is moved or grows, get different shares of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.surfels import of_unit_length
from pcore.relight.relight_config import DEFAULT, RelightConfig


@dataclass(frozen=True, kw_only=True)
class Light:
    """Lamps around a place, each a small surface that faces it.

    Attributes:
        directions: (D, 3) unit, from the centre towards the lamps; evenly over the sphere.
        radiance: (D,) how bright they look from the centre, at least 0.
        nearness: (D,) one over their distances from the centre, 1 / world unit; 0 is far away.
        center: (3,) the place, world units.
    """

    directions: Tensor
    radiance: Tensor
    nearness: Tensor
    center: Tensor

    def __post_init__(self) -> None:
        parts = (self.directions, self.radiance, self.nearness)
        shapes = [tuple(one.shape) for one in parts]
        count = len(self.radiance) if self.radiance.ndim == 1 else 0
        if count == 0 or shapes != [(count, 3), (count,), (count,)]:
            raise InputError(
                "light: expected directions (D, 3), radiance (D,) and nearness (D,), got "
                f"{shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        if tuple(self.center.shape) != (3,):
            raise InputError(f"light: expected center (3,), got {tuple(self.center.shape)}")
        dtypes = {one.dtype for one in (*parts, self.center)}
        if dtypes != {torch.float32}:
            names = ", ".join(sorted(map(str, dtypes)))
            raise InputError(f"light: expected float32 throughout, got {names}")
        self._check_values()

    def _check_values(self) -> None:
        bright = self.radiance.isfinite() & (self.radiance >= 0)
        if not bool(bright.all()) or float(self.radiance.sum()) <= 0:
            raise InputError("light: expected finite radiance of 0 or more, and some of it above 0")
        if not bool(((self.nearness >= 0) & self.nearness.isfinite()).all()):
            raise InputError("light: expected nearness of 0 (far away) or more, and finite")
        if not bool(of_unit_length(self.directions).all()):
            raise InputError("light: expected directions of unit length")
        if not bool(self.center.isfinite().all()):
            raise InputError("light: expected a finite center")

    def falling(self, points: Tensor, normals: Tensor, config: RelightConfig = DEFAULT) -> Tensor:
        """Light (N, D) that each lamp sends to surfaces; the sum is 1 where all radiance is 1.

        Args:
            points: (N, 3) world units.
            normals: (N, 3) unit.
            config: says how near a lamp may be.
        """
        offsets = points.to(normals) - self.center.to(normals)
        falling = falling_of(offsets, normals, self.directions, self.nearness, config)
        return self.radiance.to(normals) * falling

    def irradiance(self, normals: Tensor) -> Tensor:
        """Light (N,) that falls on surfaces at the centre with normals (N, 3)."""
        return self.falling(self.center.to(normals).expand_as(normals), normals).sum(dim=1)

    @property
    def mean_nearness(self) -> float:
        """Mean of the nearness by radiance, 1 / world unit."""
        return float((self.radiance * self.nearness).sum() / self.radiance.sum())

    def scaled(self, factor: float) -> Light:
        """Return the light of a world that is scaled about its origin, lamps and all."""
        return replace(self, nearness=self.nearness / factor, center=self.center * factor)


def falling_of(
    offsets: Tensor,
    normals: Tensor,
    directions: Tensor,
    nearness: Tensor,
    config: RelightConfig = DEFAULT,
) -> Tensor:
    """Light (N, D) of lamps of radiance 1 that look at a centre, on surfaces around it.

    A lamp in direction w at distance 1 / q is seen from offset p along v = w - q p. It gives
    4 / D <n, v>+ <w, v>+ / |v|^4: both cosines, and the square of the distance.

    Args:
        offsets: (N, 3) of the surfaces from the centre, world units.
        normals: (N, 3) unit.
        directions: (D, 3) unit.
        nearness: (D,) 1 / world unit.
        config: says how near a lamp may be.
    """
    directions, nearness = directions.to(normals), nearness.to(normals)
    ahead = nearness * (offsets @ directions.T)
    squared = 1 - 2 * ahead + nearness.square() * offsets.square().sum(dim=1, keepdim=True)
    across = normals @ directions.T - nearness * (normals * offsets).sum(dim=1, keepdim=True)
    # The mean cosine over the sphere is 1 / 4.
    falling = across.clamp_min(0) * (1 - ahead).clamp_min(0) * (4.0 / len(directions))
    return falling / squared.clamp_min(config.closest**2).square()


def sphere(count: int) -> Tensor:
    """Directions (D, 3) evenly over the sphere: a spiral whose steps turn by the golden angle."""
    step = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * step / count
    turn, flat = math.pi * (1 + math.sqrt(5)) * step, (1 - z * z).sqrt()
    return torch.stack([flat * turn.cos(), flat * turn.sin(), z], dim=1).float()

"""Regions: how much of an edit every place gets, and shapes that say so."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.deform.base import check_points, frozen_tensor
from pcore.deform.derivatives import gradients
from pcore.errors import InputError


class Region(ABC):
    """A weight at every place: 1 inside, 0 outside, smooth between.

    It acts on every point by itself and can be differentiated with respect to it.
    """

    @abstractmethod
    def weight(self, points: Tensor) -> Tensor:
        """Weights (...,) in [0, 1] at points (..., 3), world units."""

    def gradient(self, points: Tensor) -> Tensor:
        """Derivatives (..., 3) of the weight by position."""
        check_points(points)
        return gradients(lambda at: self.weight(at).unsqueeze(-1), points).squeeze(-2)


def ramp(distance: Tensor, falloff: float) -> Tensor:
    """1 where the distance (...,) is 0, exactly 0 from `falloff` on, world units.

    Between them the quintic s^3 (10 - 15 s + 6 s^2) of s = 1 - distance / falloff: both slope and
    curvature vanish at both ends. A falloff of 0 cuts.
    """
    if falloff == 0.0:
        return (distance <= 0).to(distance)
    rest = (1.0 - distance / falloff).clamp(0.0, 1.0)
    # Rounding may lift it above 1 by the last bit, which is no weight.
    return (rest**3 * (10.0 - 15.0 * rest + 6.0 * rest * rest)).clamp(max=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ShapeRegion(Region):
    """A shape with a seam: the weight falls over `falloff` world units outside of it."""

    falloff: float

    def __post_init__(self) -> None:
        check_falloff(self.falloff)

    def weight(self, points: Tensor) -> Tensor:
        """Weights (...,) at points (..., 3)."""
        check_points(points)
        return ramp(self._outside(points), self.falloff)

    @abstractmethod
    def _outside(self, points: Tensor) -> Tensor:
        """How far outside the shape points (..., 3) are: (...,), 0 inside."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Box(ShapeRegion):
    """A box along the axes; beyond its corners the seam is round.

    Attributes:
        lower: (3,) least coordinates, world units.
        upper: (3,) greatest coordinates.
    """

    lower: Tensor
    upper: Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "lower", frozen_tensor("box, lower corner", self.lower, (3,)))
        object.__setattr__(self, "upper", frozen_tensor("box, upper corner", self.upper, (3,)))

    def _outside(self, points: Tensor) -> Tensor:
        below, above = self.lower.to(points) - points, points - self.upper.to(points)
        return _length(below.clamp_min(0.0) + above.clamp_min(0.0), 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Sphere(ShapeRegion):
    """A ball.

    Attributes:
        center: (3,) world units.
        radius: world units.
    """

    center: Tensor
    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", frozen_tensor("sphere center", self.center, (3,)))

    def _outside(self, points: Tensor) -> Tensor:
        return _length(points - self.center.to(points), self.radius) - self.radius


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfSpace(ShapeRegion):
    """All that lies on the side of a plane that its normal points to.

    Attributes:
        origin: (3,) a point of the plane, world units.
        normal: (3,) unit length.
    """

    origin: Tensor
    normal: Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "origin", frozen_tensor("half space origin", self.origin, (3,)))
        object.__setattr__(self, "normal", frozen_tensor("half space normal", self.normal, (3,)))

    def _outside(self, points: Tensor) -> Tensor:
        height = ((points - self.origin.to(points)) * self.normal.to(points)).sum(dim=-1)
        return (-height).clamp_min(0.0)


class Union(Region):
    """What lies in any of several regions: 1 - prod (1 - w), smooth where they overlap."""

    def __init__(self, *regions: Region) -> None:
        self.regions: tuple[Region, ...] = regions

    def weight(self, points: Tensor) -> Tensor:
        """Weights (...,) at points (..., 3)."""
        check_points(points)
        rest = torch.ones_like(points[..., 0])
        for region in self.regions:
            rest = rest * (1.0 - region.weight(points))
        return 1.0 - rest


def check_falloff(falloff: float) -> None:
    """Raise InputError unless the falloff is a finite length of at least 0."""
    if not (math.isfinite(falloff) and falloff >= 0):
        raise InputError(
            f"region falloff: expected a length of 0 or more, world units, got {falloff}"
        )


def _length(vectors: Tensor, least: float) -> Tensor:
    """Length (...,) of vectors (..., 3), at least `least`; its slope is 0 where that holds."""
    squared = vectors.square().sum(dim=-1)
    long = squared > least * least
    # The root of zero has no slope: it is taken of something else and left out.
    root = torch.where(long, squared, 1.0).sqrt()
    return torch.where(long, root, least)

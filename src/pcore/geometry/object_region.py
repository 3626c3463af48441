"""Where the object of a scene is: a sphere, and a box where one is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """The region of an object, world units.

    Attributes:
        center: (3,) middle of the sphere, float32; float64 far from the origin.
        radius: of the sphere; positive.
        box: (2, 3) lower and upper corner of a box along the axes that the object lies in
            beside the sphere; None where only the sphere is known.
    """

    center: Tensor
    radius: float
    box: Tensor | None = None

    def __post_init__(self) -> None:
        if not bool(torch.isfinite(self.center).all()) or tuple(self.center.shape) != (3,):
            raise InputError(f"region: expected a centre of 3 numbers, got {self.center.tolist()}")
        if not (self.radius > 0 and math.isfinite(self.radius)):
            raise InputError(f"region: expected a positive radius, got {self.radius}")
        if self.box is None:
            return
        if tuple(self.box.shape) != (2, 3) or not bool((self.box[0] < self.box[1]).all()):
            raise InputError(
                "region: expected a box of a lower and an upper corner, 3 numbers each, got "
                f"{self.box.tolist()}"
            )

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        """(3,) lower and upper corner of the box, or of the cube around the sphere."""
        if self.box is not None:
            return self.box[0], self.box[1]
        return self.center - self.radius, self.center + self.radius

    @property
    def corners(self) -> Tensor:
        """(8, 3) of the box that `bounds` gives."""
        lower, upper = self.bounds
        return torch.cartesian_prod(*torch.stack([lower, upper]).unbind(dim=-1))

    def contains(self, points: Tensor) -> Tensor:
        """Which points (..., 3) lie in the sphere, and in the box where there is one: (...)."""
        inside = (points - self.center).norm(dim=-1) <= self.radius
        if self.box is None:
            return inside
        return inside & ((points >= self.box[0]) & (points <= self.box[1])).all(dim=-1)


def coordinates(place: Tensor, size: float) -> str:
    """A place (3,) as text, so exact that a hundredth of a size can be told, however far it lies.

    Args:
        place: world units.
        size: of what lies there, world units; positive.
    """
    step = math.floor(math.log10(size / 100))

    def said(value: float) -> str:
        digits = 1 + math.floor(math.log10(abs(value))) - step if value else 0
        return f"{value:.{max(4, digits)}g}"

    return ", ".join(said(value) for value in place.tolist())


def region_of_box(lower: Tensor, upper: Tensor) -> Region:
    """Return the region of a box along the axes, (3,) each: with the sphere through its corners."""
    box = torch.stack([lower, upper]).float()
    center = box.mean(dim=0)
    return Region(center=center, radius=float((box[1] - center).norm()), box=box)

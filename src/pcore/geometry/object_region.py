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
        center: (3,) float32 middle of the sphere.
        radius: of the sphere; positive.
        box: (2, 3) float32 lower and upper corner of a box along the axes that the object lies in
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

"""Lenses that bend straight lines (Brown 1966, as OpenCV and COLMAP write it), and the inverse."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

_STEPS = 20
"""Newton steps of the inverse; converges to 1e-9 px in five where the lens is one to one."""


@dataclass(frozen=True, kw_only=True)
class LensDistortion:
    """Distortion of pictures of one size, whose pixel centres lie at .5.

    A ray through x, y (in front of the camera at distance 1, y down) shows up at
    x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), and likewise along y.

    Attributes:
        fx: focal length along x, pixels.
        fy: focal length along y, pixels.
        cx: principal point along x, pixels.
        cy: principal point along y, pixels.
        k1: radial, of r^2.
        k2: radial, of r^4.
        k3: radial, of r^6.
        p1: tangential.
        p2: tangential.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def is_straight(self) -> bool:
        """Whether nothing is bent."""
        return not any((self.k1, self.k2, self.k3, self.p1, self.p2))

    @property
    def reach(self) -> float:
        """Largest r up to which radial distortion is one to one; infinity where it is everywhere.

        Beyond it a fitted polynomial turns back: no lens does, and the picture would show twice.
        """
        roots = np.roots([7 * self.k3, 5 * self.k2, 3 * self.k1, 1.0])
        real = [float(root.real) for root in roots if abs(root.imag) < 1e-12 and root.real > 0]
        return math.sqrt(min(real)) if real else math.inf

    def scaled(self, x: float, y: float) -> LensDistortion:
        """Return the same lens for pictures scaled by those numbers along x and y."""
        return replace(self, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y)

    def bent(self, places: Tensor) -> Tensor:
        """Where pixels (..., 2) of the straight picture, column and row, lie in the bent one."""
        x, y = self._rays(places)
        x, y = self._bend(x, y)
        return torch.stack([x * self.fx + self.cx, y * self.fy + self.cy], dim=-1)

    def straightened(self, places: Tensor) -> Tensor:
        """Where pixels (..., 2) of the bent picture lie in the straight one (Newton, float64)."""
        wanted = self._rays(places.double())
        x, y = wanted
        for _ in range(_STEPS):
            found, slopes = self._bend(x, y), self._slopes(x, y)
            off_x, off_y = found[0] - wanted[0], found[1] - wanted[1]
            xx, xy, yy = slopes
            determinant = xx * yy - xy * xy
            x = x - (yy * off_x - xy * off_y) / determinant
            y = y - (xx * off_y - xy * off_x) / determinant
        return torch.stack([x * self.fx + self.cx, y * self.fy + self.cy], dim=-1).to(places)

    def sources(self, width: int, height: int) -> tuple[Tensor, Tensor]:
        """Where each pixel of the straight picture comes from.

        Returns:
            Column and row (H, W, 2) float32 in the bent picture of the same size, and whether it
            has something there (H, W).
        """
        rows, columns = torch.meshgrid(
            torch.arange(height, dtype=torch.float32) + 0.5,
            torch.arange(width, dtype=torch.float32) + 0.5,
            indexing="ij",
        )
        places = torch.stack([columns, rows], dim=-1)
        x, y = self._rays(places)
        found = self.bent(places)
        valid = (found >= 0).all(dim=-1) & (found[..., 0] <= width) & (found[..., 1] <= height)
        valid &= (x * x + y * y).sqrt() < self.reach
        return found, valid

    def _rays(self, places: Tensor) -> tuple[Tensor, Tensor]:
        return (places[..., 0] - self.cx) / self.fx, (places[..., 1] - self.cy) / self.fy

    def _bend(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        square = x * x + y * y
        radial = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
        return (
            x * radial + 2 * self.p1 * x * y + self.p2 * (square + 2 * x * x),
            y * radial + 2 * self.p2 * x * y + self.p1 * (square + 2 * y * y),
        )

    def _slopes(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Derivatives of the bent x by x, of either by the other (they agree), and of y by y."""
        square = x * x + y * y
        radial = 1 + square * (self.k1 + square * (self.k2 + square * self.k3))
        slope = 2 * (self.k1 + square * (2 * self.k2 + square * 3 * self.k3))
        return (
            radial + x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x,
            x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y,
            radial + y * y * slope + 2 * self.p2 * x + 6 * self.p1 * y,
        )

"""From where an object was photographed, and from where it was not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.capture_axes import capture_axes

_NEAR = 30.0
"""A direction is covered when a camera stands within so many degrees of it."""
ONE_SIDE = 180.0
"""Degrees of a gap from which on all cameras stand on one side."""
_DIRECTIONS = 2000


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Where cameras stand around the middle of a region.

    Attributes:
        up: (3,) what was up for the photographer, unit length.
        azimuth: (N,) degrees around `up`, -180 to 180, from an arbitrary direction.
        elevation: (N,) degrees above the plane across `up`.
        distance: (N,) world units.
        gap: degrees of the largest part of the circle that no camera stands in.
        gap_middle: azimuth of its middle, degrees.
        sphere: share of all directions that a camera stands within 30 degrees of.
    """

    up: Tensor
    azimuth: Tensor
    elevation: Tensor
    distance: Tensor
    gap: float
    gap_middle: float
    sphere: float


def coverage(cameras: Sequence[Camera], center: Tensor) -> Coverage:
    """Say where cameras stand around a place.

    Args:
        cameras: at least one.
        center: (3,) world units.
    """
    poses = torch.stack([camera.world_from_camera for camera in cameras]).double()
    up = capture_axes(cameras)[:, 2].double()
    offsets = poses[:, :3, 3] - center.double()
    distance = offsets.norm(dim=-1).clamp_min(1e-12)
    directions = offsets / distance[:, None]
    side = torch.eye(3).double()[int(up.abs().argmin())]
    side = side - (side @ up) * up
    side = side / side.norm()
    ahead = torch.linalg.cross(up, side)
    azimuth = torch.rad2deg(torch.atan2(directions @ ahead, directions @ side))
    gap, middle = _largest_gap(azimuth)
    near = _directions() @ directions.T > math.cos(math.radians(_NEAR))
    return Coverage(
        up=up.float(),
        azimuth=azimuth.float(),
        elevation=torch.rad2deg(torch.arcsin((directions @ up).clamp(-1, 1))).float(),
        distance=distance.float(),
        gap=gap,
        gap_middle=middle,
        sphere=float(near.any(dim=1).double().mean()),
    )


def _largest_gap(azimuth: Tensor) -> tuple[float, float]:
    ordered = azimuth.sort().values
    gaps = torch.cat([ordered[1:], ordered[:1] + 360]) - ordered
    widest = int(gaps.argmax())
    middle = float(ordered[widest] + gaps[widest] / 2)
    return float(gaps[widest]), (middle + 180) % 360 - 180


def _directions() -> Tensor:
    """Directions (D, 3) spread evenly over the sphere (a Fibonacci lattice)."""
    count = torch.arange(_DIRECTIONS, dtype=torch.float64)
    height = 1 - (2 * count + 1) / _DIRECTIONS
    turn = math.pi * (3 - math.sqrt(5)) * count
    ring = (1 - height * height).sqrt()
    return torch.stack([ring * turn.cos(), ring * turn.sin(), height], dim=-1)

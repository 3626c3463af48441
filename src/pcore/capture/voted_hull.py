"""The hull that most masks agree on, and its outlines in pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region
from pcore.packages import package

Bits = NDArray[np.uint8]

VOXELS = 80
_SEEN = 0.15
"""Share of all views that must see a voxel."""


def hull_silhouettes(
    cameras: Sequence[Camera],
    masks: Sequence[Bits],
    region: Region,
    *,
    votes: Sequence[float],
    into: Sequence[Camera],
    voxels: int = VOXELS,
) -> list[list[Bits]]:
    """Outlines (H, W) 0 or 1 of the hulls that most masks agree on, for each share of votes.

    Args:
        cameras: of the masks.
        masks: (H, W) 0 or 1.
        region: where voxels are looked at, with room around it.
        votes: shares of the views that see a voxel and must have it in their mask.
        into: pictures that the hull is drawn in.
        voxels: along the longest side of the region.
    """
    places, size = _grid(region, voxels)
    seen, within = torch.zeros(len(places)), torch.zeros(len(places))
    for camera, mask in zip(cameras, masks, strict=True):
        visible, pixels = _pixels(camera, places)
        seen += visible
        within[visible] += torch.from_numpy(mask)[pixels].float()
    least = max(2.0, _SEEN * len(cameras))
    hulls = [places[(seen >= least) & (within >= vote * seen)] for vote in votes]
    return [[_splat(camera, hull, size) for camera in into] for hull in hulls]


def require_opencv() -> Any:
    """Return OpenCV.

    Raises:
        DependencyError: it is not installed.
    """
    return package(
        "cv2", extra="capture", need="automatic masks need", named="opencv-python-headless"
    )


def _grid(region: Region, count: int) -> tuple[Tensor, float]:
    """Centres (V, 3) of cubic voxels that fill the region with room around it, and their size."""
    lower, upper = region.bounds
    room = 0.25 * (upper - lower).max()
    lower, upper = lower - room, upper + room
    longest = float((upper - lower).max())
    size = longest / count
    axes = [
        float(low) + size * (torch.arange(max(1, round(float(high - low) / size))) + 0.5)
        for low, high in zip(lower, upper, strict=True)
    ]
    places = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)
    if region.box is None:  # A sphere; half of its cube lies in corners.
        places = places[(places - region.center).norm(dim=-1) <= 0.5 * longest]
    return places, size


def _pixels(camera: Camera, places: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """Which places (V, 3) are in the picture (V,), and row and column of those."""
    column, row, depth = camera.project(places)
    visible = (depth > 0) & (column >= 0) & (column < camera.width)
    visible &= (row >= 0) & (row < camera.height)
    return visible, (row[visible].long(), column[visible].long())


def _splat(camera: Camera, places: Tensor, size: float) -> Bits:
    """Outline (H, W) 0 or 1 of voxels of a size in a picture."""
    cv2 = require_opencv()
    picture = np.zeros((camera.height, camera.width), dtype=np.uint8)
    if len(places) == 0:
        return picture
    _, pixels = _pixels(camera, places)
    picture[pixels[0].numpy(), pixels[1].numpy()] = 1
    wide = max(1, math.ceil(0.5 * size / camera.pixel_width(places.mean(dim=0))))
    kernel = np.ones((2 * wide + 1, 2 * wide + 1), np.uint8)
    return cv2.morphologyEx(picture, cv2.MORPH_CLOSE, kernel)

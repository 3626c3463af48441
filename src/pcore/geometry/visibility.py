"""Which points cameras see: a point is seen where no nearer part of its cloud covers it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import as_points, nearest

FloatArray = NDArray[np.float64]

_NEIGHBOURS = 8
_CELL = 2.0
"""Side of the cells of the depth buffer in spacings: wide enough that a surface has no gaps."""
_SLACK = 2.0
"""Spacings that a point may lie behind the first of its cell: clouds are as thick as that."""
_VOTES = 3


def cloud_spacing(points: Tensor) -> float:
    """Median over points (N, 3) of the mean distance to the 8 nearest others, world units.

    Raises:
        InputError: fewer than two points, another shape, NaN or infinity.
    """
    places = torch.from_numpy(as_points(points))
    if len(places) < 2:
        raise InputError("visibility: expected at least two points, got one")
    _, near = nearest(places, places, _NEIGHBOURS + 1)
    return float(near[:, 1:].mean(dim=1).median())


def visible_from(points: Tensor, camera: Camera, spacing: float) -> Tensor:
    """Tell which points one camera sees.

    The picture is cut into square cells, 2 spacings wide at the mean depth of the cloud. A point
    is seen when it lies inside the picture and at most 2 spacings behind the nearest point of its
    cell. Depths are those of the points, not of a rendering: those are means over points, which
    lie within the object, and say less about what is in front (docs/research/diagnosis.md).

    Args:
        points: (N, 3) world units.
        camera: who looks.
        spacing: of the cloud, from `cloud_spacing` before it is deformed.

    Returns:
        (N,) bool.
    """
    column, row, depth = _projected(points, camera)
    inside = (depth > 0) & (column >= 0) & (column < camera.width)
    inside &= (row >= 0) & (row < camera.height)
    seen = np.zeros(len(depth), dtype=bool)
    if not inside.any():
        return torch.from_numpy(seen)
    depth = depth[inside]
    # Points in one place have no spacing; the cell is then far below a pixel.
    wide = max(_CELL * spacing / float(depth.mean()), 1e-9)
    i = np.floor(row[inside] / (camera.focal[1] * wide)).astype(np.int64)
    j = np.floor(column[inside] / (camera.focal[0] * wide)).astype(np.int64)
    _, cell = np.unique(i * (j.max() + 1) + j, return_inverse=True)
    first = np.full(int(cell.max()) + 1, np.inf)
    np.minimum.at(first, cell, depth)
    seen[inside] = depth <= first[cell] + _SLACK * spacing
    return torch.from_numpy(seen)


def seen_by(points: Tensor, cameras: Iterable[Camera], spacing: float | None = None) -> Tensor:
    """Tell which points at least one of the cameras sees.

    Args:
        points: (N, 3) world units.
        cameras: any number.
        spacing: see `visible_from`; None measures that of these points.

    Returns:
        (N,) bool.

    Raises:
        InputError: as `cloud_spacing`.
    """
    width = cloud_spacing(points) if spacing is None else spacing
    seen = torch.zeros(len(points), dtype=torch.bool)
    for camera in cameras:
        seen |= visible_from(points, camera, width)
    return seen


def unseen_pixels(
    points: Tensor, unseen: Tensor, camera: Camera, alpha: Tensor, spacing: float
) -> Tensor:
    """Tell which pixels of a rendering show unseen points.

    A pixel shows them when most of the 3 points nearest to it in the picture, among those that the
    camera sees, are unseen.

    Args:
        points: (N, 3) where the points are in the picture, world units.
        unseen: (N,) bool, which points no training camera saw.
        camera: who looks.
        alpha: (H, W) opacity of the rendering; only pixels of at least 0.5 are asked.
        spacing: see `visible_from`.

    Returns:
        (H, W) bool.
    """
    result = torch.zeros(alpha.shape, dtype=torch.bool)
    object_pixels = alpha.detach().cpu() >= 0.5
    front = visible_from(points, camera, spacing).numpy()
    if not front.any() or not bool(object_pixels.any()):
        return result
    column, row, _ = _projected(points, camera)
    tree: Any = KDTree(np.stack([row[front], column[front]], axis=1))
    votes = min(_VOTES, int(front.sum()))
    _, near = tree.query(object_pixels.nonzero().numpy() + 0.5, k=np.arange(1, votes + 1))
    share = unseen.cpu().numpy()[front][np.asarray(near)].mean(axis=1)
    result[object_pixels] = torch.from_numpy(share > 0.5)
    return result


def unseen_share(pixels: Tensor, alpha: Tensor) -> float:
    """Share of the object's pixels (opacity (H, W) of at least 0.5) among those; 0 without any."""
    count = int((alpha >= 0.5).sum())
    return float(pixels.sum()) / count if count else 0.0


def _projected(points: Tensor, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Column, row and depth (N,) of points; places in the picture of those behind mean nothing."""
    column, row, depth = camera.project(torch.from_numpy(as_points(points)))
    return column.numpy(), row.numpy(), depth.numpy()

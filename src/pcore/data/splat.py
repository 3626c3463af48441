"""Pictures of bare points: coloured dots, the nearer over the farther."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera


def point_picture(points: Tensor, colors: Tensor, camera: Camera, *, dot: int = 3) -> Tensor:
    """Draw points as square dots on white.

    Args:
        points: (N, 3) world units.
        colors: (N, 3) uint8.
        camera: who looks.
        dot: side of a dot in pixels.

    Returns:
        (H, W, 3) uint8.

    Raises:
        InputError: not one colour for each point.
    """
    if colors.shape != points.shape or colors.dtype != torch.uint8:
        raise InputError(
            f"point picture: expected colours (N, 3) uint8 for {len(points)} points, got "
            f"{tuple(colors.shape)} {colors.dtype}"
        )
    from_world = torch.linalg.inv(camera.world_from_camera.cpu().double())
    local = (points.detach().cpu().double() @ from_world[:3, :3].T + from_world[:3, 3]).numpy()
    paint, depth = colors.cpu().numpy(), -local[:, 2]
    front = depth > 0
    local, paint, depth = local[front], paint[front], depth[front]
    column = np.floor(camera.cx + camera.fx * local[:, 0] / depth).astype(np.int64)
    row = np.floor(camera.cy - camera.fy * local[:, 1] / depth).astype(np.int64)
    reach = np.arange(dot) - dot // 2
    rows = (row[:, None, None] + reach[:, None]).repeat(dot, axis=2).reshape(len(row), -1)
    columns = (column[:, None, None] + reach).repeat(dot, axis=1).reshape(len(row), -1)
    # Painted from the farthest to the nearest: what comes later covers.
    order = np.argsort(-depth, kind="stable")
    rows, columns = rows[order].ravel(), columns[order].ravel()
    paint = paint[order].repeat(dot * dot, axis=0)
    inside = (rows >= 0) & (rows < camera.height) & (columns >= 0) & (columns < camera.width)
    picture = np.full((camera.height, camera.width, 3), 255, dtype=np.uint8)
    picture[rows[inside], columns[inside]] = paint[inside]
    return torch.from_numpy(picture)

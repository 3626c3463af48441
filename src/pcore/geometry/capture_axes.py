"""Axes that turn along with a capture, whatever the axes of its world are."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.upward import upward

_ALONG = 0.9


def capture_axes(cameras: Sequence[Camera]) -> Tensor:
    """Return world_from_axes (3, 3) float32, right-handed: the first camera's right, ahead, up.

    Args:
        cameras: at least one; the same capture has them in the same order.
    """
    poses = [one.world_from_camera.detach().cpu().double() for one in cameras]
    turns = torch.stack([one[:3, :3] for one in poses])
    first = turns[0]
    up = torch.from_numpy(upward(turns[:, :, 0].numpy(), turns[:, :, 1].numpy()))
    # A camera that is turned by a quarter has its right along up, and looks across it.
    side = first[:, 0] if abs(float(first[:, 0] @ up)) < _ALONG else first[:, 2]
    side = torch.nn.functional.normalize(side - (side @ up) * up, dim=0)
    return torch.stack([side, torch.linalg.cross(up, side), up], dim=1).float()

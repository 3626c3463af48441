"""Axes that turn along with a capture, whatever the axes of its world are."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.geometry.camera import Camera

_CANCELLED = 1e-3
"""Shorter mean upward axes say nothing: the cameras look at the object any way up."""
_ALONG = 0.9


def capture_axes(cameras: Sequence[Camera]) -> Tensor:
    """Return world_from_axes (3, 3) float32, right-handed: the first camera's right, ahead, up.

    Up is the mean of the cameras' upward axes; where these cancel, that of the first camera.

    Args:
        cameras: at least one; the same capture has them in the same order.
    """
    first = cameras[0].world_from_camera.double()[:3, :3]
    up = torch.stack([one.world_from_camera.double()[:3, 1] for one in cameras]).mean(dim=0)
    up = first[:, 1] if float(up.norm()) < _CANCELLED else up / up.norm()
    # A camera that is turned by a quarter has its right along up, and looks across it.
    side = first[:, 0] if abs(float(first[:, 0] @ up)) < _ALONG else first[:, 2]
    side = torch.nn.functional.normalize(side - (side @ up) * up, dim=0)
    return torch.stack([side, torch.linalg.cross(up, side), up], dim=1).float()

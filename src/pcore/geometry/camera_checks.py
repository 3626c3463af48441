"""What a camera's pose must be."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.errors import InputError

_RIGID_TOLERANCE = 1e-3


def check_kind(pose: object) -> None:
    """Refuse a pose that is no tensor of floating point; raises InputError."""
    if isinstance(pose, Tensor) and pose.is_floating_point():
        return
    got = f"one of {pose.dtype}" if isinstance(pose, Tensor) else type(pose).__name__
    raise InputError(
        f"camera pose: expected a tensor of float32 or float64, got {got}; make one with "
        "`torch.as_tensor(pose, dtype=torch.float64)`"
    )


def check_pose(pose: Tensor) -> None:
    """Refuse a pose that is not finite, rigid and right-handed (4, 4); raises InputError."""
    if tuple(pose.shape) != (4, 4):
        raise InputError(f"camera pose: expected a 4 x 4 matrix, got shape {tuple(pose.shape)}")
    if not bool(torch.isfinite(pose).all()):
        raise InputError("camera pose: expected finite numbers, got NaN or infinity")
    rotation = pose[:3, :3].double()
    error = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max().item()
    if error <= _RIGID_TOLERANCE and torch.linalg.det(rotation).item() < 0:
        raise InputError(
            "camera pose: expected a right-handed rotation, got a mirrored one (determinant -1); "
            "negate one column of its 3 x 3 block: the camera looks along -z, with y up"
        )
    if error > _RIGID_TOLERANCE:
        raise InputError(
            "camera pose: expected a rigid world_from_camera (orthonormal rotation), "
            f"got a 3 x 3 block that is off by {error:.2g}; remove scale and shear from the pose"
        )

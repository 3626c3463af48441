"""Cameras as the rasterisers take them, and back from their depths to places."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.geometry.camera import Camera

_OPENCV = (1.0, -1.0, -1.0)


def view_matrices(cameras: Sequence[Camera], like: Tensor) -> tuple[Tensor, Tensor]:
    """Camera from world (C, 4, 4) in OpenCV axes, and pinhole matrices (C, 3, 3).

    Args:
        cameras: C of them; gradients go to their poses and numbers.
        like: gives device and type.
    """
    poses = torch.stack([camera.world_from_camera for camera in cameras]).to(like)
    axes = like.new_tensor(_OPENCV)
    # The inverse of a rigid map; rows are the axes right, down, forward.
    rotation = axes[:, None] * poses[:, :3, :3].mT
    shift = -rotation @ poses[:, :3, 3:]
    bottom = like.new_tensor([[0.0, 0.0, 0.0, 1.0]]).expand(len(cameras), 1, 4)
    viewmats = torch.cat([torch.cat([rotation, shift], dim=-1), bottom], dim=-2)
    return viewmats, torch.stack([_pinhole(one) for one in cameras]).to(like)


def _pinhole(camera: Camera) -> Tensor:
    """Its matrix (3, 3), float64 on the CPU."""
    fx, fy, cx, cy = (
        torch.as_tensor(one, dtype=torch.float64, device="cpu")
        for one in (camera.fx, camera.fy, camera.cx, camera.cy)
    )
    zero, one = fx.new_zeros(()), fx.new_ones(())
    return torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one]).reshape(3, 3)


def surface_points(depth: Tensor, camera: Camera) -> Tensor:
    """World points (H, W, 3) at a camera z (H, W) along the rays through the pixels' centres."""
    rays = camera.rays()
    forward = -camera.world_from_camera[:3, 2]
    # As in `RayBundle.at`: what is not known must not make gradients of the camera NaN.
    unknown = depth.isnan()
    steps = depth.masked_fill(unknown, 0.0) / (rays.directions @ forward).to(depth)
    return rays.at(steps.masked_fill(unknown, math.nan))

"""Cameras along a path through given ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp

from pcore.errors import InputError
from pcore.geometry.camera import Camera


def path_through(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Cameras (count) evenly along a list of at least one, from the first to the last.

    Between two of the list positions go straight, rotations turn evenly about one axis, and focal
    lengths and principal points change evenly.

    Raises:
        InputError: no camera, fewer than one wanted, or pictures of several sizes.
    """
    if not cameras or count < 1:
        raise InputError(
            f"camera path: expected at least one camera and one frame, got {len(cameras)} and "
            f"{count}"
        )
    sizes = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    if len(sizes) > 1:
        listed = " and ".join(f"{width} x {height}" for width, height in sizes)
        raise InputError(
            f"camera path: expected cameras with pictures of one size, got {listed}; give a size"
        )
    if len(cameras) == 1 or count == 1:
        return [cameras[0]] * count
    poses = np.stack([camera.world_from_camera.double().numpy() for camera in cameras])
    places = np.linspace(0.0, len(cameras) - 1.0, count)
    turns = Slerp(np.arange(len(cameras)), Rotation.from_matrix(poses[:, :3, :3]))(places)
    centers = [np.interp(places, np.arange(len(cameras)), poses[:, k, 3]) for k in range(3)]
    path = np.tile(np.eye(4), (count, 1, 1))
    path[:, :3, :3] = turns.as_matrix()
    path[:, :3, 3] = np.stack(centers, axis=1)
    kind = cameras[0].world_from_camera.dtype
    lens = {
        name: np.interp(places, np.arange(len(cameras)), [getattr(one, name) for one in cameras])
        for name in ("fx", "fy", "cx", "cy")
    }
    return [
        replace(
            cameras[0],
            world_from_camera=torch.from_numpy(pose).to(kind),
            **{name: float(values[index]) for name, values in lens.items()},
        )
        for index, pose in enumerate(path)
    ]

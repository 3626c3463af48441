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

    Between two of the list positions go straight and rotations turn evenly about one axis; image
    size and focal lengths are those of the first.

    Raises:
        InputError: no camera, or fewer than one wanted.
    """
    if not cameras or count < 1:
        raise InputError(
            f"camera path: expected at least one camera and one frame, got {len(cameras)} and "
            f"{count}"
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
    return [replace(cameras[0], world_from_camera=torch.from_numpy(one).to(kind)) for one in path]

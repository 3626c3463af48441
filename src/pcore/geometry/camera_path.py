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
    _check_sizes(cameras)
    if len(cameras) == count:  # As they are, to the last bit.
        return list(cameras)
    if len(cameras) == 1 or count == 1:
        return [cameras[0]] * count
    places = np.linspace(0.0, len(cameras) - 1.0, count)
    return path_at(list(enumerate(cameras)), places.tolist())


def path_at(keys: Sequence[tuple[float, Camera]], times: Sequence[float]) -> list[Camera]:
    """Cameras at times, between cameras at increasing times as `path_through` has them.

    Before the first key and after the last one they stand still.

    Raises:
        InputError: no key, or pictures of several sizes.
    """
    cameras = [camera for _, camera in keys]
    if len(cameras) < 2:
        return path_through(cameras, len(times))
    _check_sizes(cameras)
    given = np.array([float(time) for time, _ in keys])
    places = np.clip(np.asarray(times, dtype=float), given[0], given[-1])
    poses = np.stack([camera.world_from_camera.double().numpy() for camera in cameras])
    turns = Slerp(given, Rotation.from_matrix(poses[:, :3, :3]))(places)
    centers = [np.interp(places, given, poses[:, k, 3]) for k in range(3)]
    path = np.tile(np.eye(4), (len(times), 1, 1))
    path[:, :3, :3] = turns.as_matrix()
    path[:, :3, 3] = np.stack(centers, axis=1)
    kind = cameras[0].world_from_camera.dtype
    lens = {
        name: np.interp(places, given, [getattr(one, name) for one in cameras])
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


def _check_sizes(cameras: Sequence[Camera]) -> None:
    sizes = dict.fromkeys((camera.width, camera.height) for camera in cameras)
    if len(sizes) > 1:
        listed = " and ".join(f"{width} x {height}" for width, height in sizes)
        raise InputError(
            f"camera path: expected cameras with pictures of one size, got {listed}; give a size"
        )

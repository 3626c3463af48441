"""Cameras as photographers held them: files of portraits lie, and their tag says how."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from pcore.data.scene import View
from pcore.geometry.camera import Camera

_TURNS = {
    3: [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
    6: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
    8: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
}
"""What the EXIF tags of turned pictures make of right, up and back."""


def held_cameras(views: Sequence[View]) -> list[Camera]:
    """Cameras whose upward axes are up for who sees the photos turned as their EXIF tags say.

    COLMAP poses pictures as they are stored, and those of a phone held upright are stored lying.
    Their places and axes of view stay; sizes and intrinsics are still those of the stored pixels.
    """
    return [_held(view) for view in views]


def _held(view: View) -> Camera:
    turn = None if view.image.upright else _TURNS.get(view.image.header.orientation)
    if turn is None:
        return view.camera
    pose = view.camera.world_from_camera.clone()
    pose[:3, :3] = pose[:3, :3] @ torch.tensor(turn, dtype=pose.dtype)
    return view.camera.moved(pose)

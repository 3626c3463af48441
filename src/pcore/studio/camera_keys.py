"""Cameras at times of the keyframes, and the file beside an edit file that keeps them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from pcore.data.whole_file import save_json
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.studio.outputs import camera_frame

CameraKeys = list[tuple[float, Camera]]
"""Cameras at increasing times."""


def frames_of(keys: Sequence[tuple[float, Camera]]) -> list[dict[str, Any]]:
    """Camera keys as frames of a transforms file, each with its time."""
    return [
        {"file_path": f"key_{number:03}", "time": time, **camera_frame(camera)}
        for number, (time, camera) in enumerate(keys, start=1)
    ]


def keys_of(frames: Any) -> CameraKeys:
    """Camera keys of such frames; those that are damaged are left out."""
    found = map(_key, frames if isinstance(frames, list) else ())
    return sorted((key for key in found if key is not None), key=lambda key: key[0])


def keys_file(edit: Path) -> Path:
    """The file of the camera keys of an edit file: edit.cameras.json of edit.json alone."""
    return edit.with_name(f"{edit.name.removesuffix('.json')}.cameras.json")


def write_keys(edit: Path, keys: Sequence[tuple[float, Camera]]) -> None:
    """Write camera keys beside an edit file; a file is not begun for none.

    Raises:
        InputError: it cannot be written.
    """
    path = keys_file(edit)
    if keys or path.is_file():
        save_json(path, {"frames": frames_of(keys)}, "camera keys")


def read_keys(edit: Path) -> CameraKeys:
    """Read the camera keys beside an edit file; none where there is no such file.

    Raises:
        InputError: it is damaged.
    """
    path = keys_file(edit)
    if not path.is_file():
        return []
    try:
        frames = json.loads(path.read_bytes())["frames"]
        keys = keys_of(frames)
        if len(keys) != len(frames):
            raise ValueError("a frame lacks its time or its camera")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: expected camera keys as the studio saves them, got a damaged file ({error}); "
            "mend it or take it away"
        ) from error
    return keys


def _key(frame: Any) -> tuple[float, Camera] | None:
    try:
        camera = Camera(
            world_from_camera=torch.tensor(frame["transform_matrix"]),
            width=int(frame["w"]),
            height=int(frame["h"]),
            fx=float(frame["fl_x"]),
            fy=float(frame["fl_y"]),
            cx=float(frame["cx"]),
            cy=float(frame["cy"]),
        )
        return float(frame["time"]), camera
    except (KeyError, TypeError, ValueError, InputError):
        return None

"""Cameras into files of other programs: transforms.json and the text model of COLMAP."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from pcore.data.pictures import to_bytes
from pcore.data.whole_file import write_whole
from pcore.geometry.camera import Camera

TRANSFORMS = "transforms.json"
_OPENCV = np.diag([1.0, -1.0, -1.0])


def save_transforms(
    path: Path,
    cameras: Sequence[tuple[str, Camera]],
    *,
    files: Mapping[str, str] | None = None,
    keys: Mapping[str, Any] | None = None,
    times: Sequence[float | None] | None = None,
) -> None:
    """Write cameras as nerfstudio, instant-ngp and pcore read them.

    Args:
        path: the file, in a folder that exists.
        cameras: by name.
        files: what `file_path` is for a name; None writes `images/NAME.png`.
        keys: further keys of the file, or of each frame under "frames" by name.
        times: `time` of each camera, as D-NeRF has it; None for one that has none.

    Raises:
        InputError: a place that is not writable.
    """
    further = dict(keys or {})
    of_frames: Mapping[str, Any] = further.pop("frames", {})
    frames = [
        {
            "file_path": f"images/{name}.png" if files is None else files[name],
            **_intrinsics(camera),
            "transform_matrix": camera.world_from_camera.double().tolist(),
            **of_frames.get(name, {}),
            **({} if time is None else {"time": time}),
        }
        for (name, camera), time in zip(cameras, times or [None] * len(cameras), strict=True)
    ]
    content = {"camera_model": "OPENCV", **_shared(frames), **further, "frames": frames}
    write_whole(path, (json.dumps(content, indent=1) + "\n").encode(), "cameras")


def save_colmap(
    folder: Path, cameras: Sequence[tuple[str, Camera]], points: Tensor, colors: Tensor | None
) -> list[Path]:
    """Write cameras and points as a COLMAP model in text, one PINHOLE camera for each picture.

    Args:
        folder: that exists.
        cameras: by name; pictures are NAME.png.
        points: (N, 3) world units.
        colors: (N, 3) in [0, 1]; None writes grey.

    Returns:
        cameras.txt, images.txt and points3D.txt.

    Raises:
        InputError: a place that is not writable.
    """
    lenses = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then an empty line"]
    for number, (name, camera) in enumerate(cameras, start=1):
        lens = " ".join(f"{float(x):.9g}" for x in (camera.fx, camera.fy, camera.cx, camera.cy))
        lenses.append(f"{number} PINHOLE {camera.width} {camera.height} {lens}")
        images += [f"{number} {_pose(camera)} {number} {name}.png", ""]
    paint = np.full((len(points), 3), 128) if colors is None else to_bytes(colors).numpy()
    rows = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]"]
    for number, (x, y, z) in enumerate(points.double().tolist(), start=1):
        red, green, blue = paint[number - 1]
        rows.append(f"{number} {x:.9g} {y:.9g} {z:.9g} {red} {green} {blue} 0")
    texts = {"cameras.txt": lenses, "images.txt": images, "points3D.txt": rows}
    for name, lines in texts.items():
        write_whole(folder / name, ("\n".join(lines) + "\n").encode(), "COLMAP model")
    return [folder / name for name in texts]


def _pose(camera: Camera) -> str:
    """Quaternion w x y z and translation of camera from world, OpenCV axes."""
    pose = camera.world_from_camera.double().numpy()
    rotation = _OPENCV @ pose[:3, :3].T
    shift = -rotation @ pose[:3, 3]
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return " ".join(f"{number:.12g}" for number in (w, x, y, z, *shift))


def _intrinsics(camera: Camera) -> dict[str, float | int]:
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
    }


def _shared(frames: list[dict[str, Any]]) -> dict[str, Any]:
    """Take intrinsics that all frames have out of them."""
    names = ("w", "h", "fl_x", "fl_y", "cx", "cy")
    if len({tuple(frame[name] for name in names) for frame in frames}) != 1:
        return {}
    shared = {name: frames[0][name] for name in names}
    for frame in frames:
        for name in names:
            del frame[name]
    return shared

"""Folders as phone scanners write them: Polycam's `keyframes` and Record3D's `EXR_RGBD`.

Both are of Apple's ARKit: y up, camera axes as OpenGL's, metres. Worlds are kept as they are.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pcore.capture.photos import Capture, Photo, inside, pictures_in
from pcore.errors import SceneError
from pcore.geometry.lens_distortion import LensDistortion

_Content = TypeVar("_Content")
KEYFRAMES, METADATA = "keyframes", "metadata.json"
_POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
"""Folders of cameras and photos; those after Polycam's own bundle adjustment first."""


def polycam_cameras(root: Path) -> Path | None:
    """The folder of cameras of a raw Polycam export; None where it is none."""
    for base in (root / KEYFRAMES, root):
        for cameras, images in _POLYCAM:
            folder = base / cameras
            if (base / images).is_dir() and next(folder.glob("*.json"), None) is not None:
                return folder
    return None


def record3d_metadata(root: Path) -> Path | None:
    """The `metadata.json` of a Record3D export with photos beside it; None where it is none."""
    for base in (root, root / "EXR_RGBD"):
        if (base / METADATA).is_file() and (base / "rgb").is_dir():
            return base / METADATA
    return None


def read_polycam(root: Path, path: Path, factor: int) -> Capture:
    """Read the cameras of a Polycam export, one JSON file each, and their photos.

    Args:
        root: folder of the capture.
        path: folder of the cameras.
        factor: not used: there are no smaller copies of the photos.

    Raises:
        SceneError: a file that holds something else.
    """
    del factor
    images = {cameras: photos for cameras, photos in _POLYCAM}[path.name]
    files = {one.stem: one for one in pictures_in(path.parent / images)}
    photos: list[Photo] = []
    for file in sorted(inside(root, one) for one in path.glob("*.json")):

        def read(said: Any, file: Path = file) -> Photo:
            rows = [[float(said[f"t_{row}{column}"]) for column in range(4)] for row in range(3)]
            return _photo(
                file.stem,
                None if file.stem not in files else inside(root, files[file.stem]),
                torch.tensor([*rows, [0, 0, 0, 1]], dtype=torch.float64),
                (float(said["fx"]), float(said["fy"]), float(said["cx"]), float(said["cy"])),
                (int(said["width"]), int(said["height"])),
            )

        photos.append(_read(file, read, "a camera of Polycam (t_00 to t_23, fx, fy, cx, cy, size)"))
    notes = []
    if path.name == _POLYCAM[1][0]:
        notes = ["cameras are those of the phone while it moved, without Polycam's corrections"]
    return Capture(layout="Polycam", where=str(path), photos=photos, notes=notes)


def read_record3d(root: Path, path: Path, factor: int) -> Capture:
    """Read a Record3D export: poses and intrinsics in one file, photos `rgb/NUMBER`.

    Args:
        root: folder of the capture.
        path: the `metadata.json`.
        factor: not used: there are no smaller copies of the photos.

    Raises:
        SceneError: the file holds something else.
    """
    del factor
    files = {one.stem: one for one in pictures_in(path.parent / "rgb")}

    def read(said: Any) -> list[Photo]:
        size = (int(said["w"]), int(said["h"]))
        shared = np.array(said["K"], dtype=np.float64).reshape(3, 3).T  # It is written by columns.
        own = said.get("perFrameIntrinsicCoeffs")
        photos: list[Photo] = []
        for number, (*quaternion, x, y, z) in enumerate(said["poses"]):
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
            pose[:3, 3] = x, y, z
            lens = shared[[0, 1, 0, 1], [0, 1, 2, 2]].tolist() if not own else own[number]
            file = files.get(str(number))
            image = None if file is None else inside(root, file)
            fx, fy, cx, cy = map(float, lens)
            photos.append(
                _photo(str(number), image, torch.from_numpy(pose), (fx, fy, cx, cy), size)
            )
        return photos

    photos = _read(path, read, "the metadata of Record3D (w, h, K and poses of 7 numbers)")
    return Capture(layout="Record3D", where=str(path), photos=photos)


def _photo(
    name: str,
    path: Path | None,
    pose: torch.Tensor,
    lens: tuple[float, float, float, float],
    size: tuple[int, int],
) -> Photo:
    fx, fy, cx, cy = lens
    if not (min(fx, fy) > 0 and np.isfinite(lens).all()):
        raise ValueError(f"no lens: {lens}")
    return Photo(
        name=name,
        path=path,
        world_from_camera=pose,
        lens=LensDistortion(fx=fx, fy=fy, cx=cx, cy=cy),
        size=size,
    )


def _read(path: Path, read: Callable[[Any], _Content], expected: str) -> _Content:
    try:
        return read(json.loads(path.read_text(encoding="utf-8-sig", errors="replace")))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError) as problem:
        raise SceneError(
            f"{path}: expected {expected}, got something else ({problem!r:.80}); export it again"
        ) from problem

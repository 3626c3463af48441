"""Layouts with a file per pose or a list of cameras: NSVF and `cameras.json` of 3DGS."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.capture.colmap import opengl_pose
from pcore.capture.photo_folders import find_photos
from pcore.capture.photos import Capture, Photo, inside, natural_key, pictures_in
from pcore.data.scene import Skipped
from pcore.errors import InputError, SceneError
from pcore.geometry.lens_distortion import LensDistortion
from pcore.geometry.object_region import Region, region_of_box


def read_nsvf(root: Path, path: Path, factor: int) -> Capture:
    """Read NSVF's layout: `intrinsics.txt`, `pose/*.txt`, `rgb/*`, and `bbox.txt` as the region.

    Names that begin with 0_ are for training, 1_ for validation and 2_ for tests (where none begins
    with 2_, as in its Tanks and Temples, 1_ is for tests).

    Raises:
        SceneError: files that hold other numbers, or no pose at all.
    """
    del factor
    lens, size = _nsvf_lens(path)
    photos: list[Photo] = []
    poses = {one.stem: one for one in sorted((root / "pose").glob("*.txt"))}
    pictures = pictures_in(root / "rgb")
    images = {one.stem: one for one in reversed(pictures)}  # The first of two of one name.
    for stem in sorted(poses, key=natural_key):
        pose = _numbers(inside(root, poses[stem]), 16).reshape(4, 4)
        turned = torch.from_numpy(pose * np.array([1.0, -1.0, -1.0, 1.0]))
        image = images.get(stem)
        photos.append(
            Photo(
                name=stem,
                path=None if image is None else inside(root, image),
                world_from_camera=turned,
                lens=lens,
                size=size,
            )
        )
    if not photos:
        raise SceneError(f"{root / 'pose'}: expected a text file of 4 x 4 numbers for each photo")
    names = [photo.name for photo in photos]
    return Capture(
        layout="NSVF / Tanks and Temples",
        where=str(path),
        photos=photos,
        region=_nsvf_box(root, "bbox.txt"),
        splits=_prefixes(names),
        skipped=[
            Skipped(name=one.name, reason="no pose of its own")
            for one in pictures
            if one.stem not in poses or images[one.stem] != one
        ],
    )


def read_camera_list(root: Path, path: Path, factor: int) -> Capture:
    """Read the `cameras.json` of 3D Gaussian splatting, with photos in `images` or beside it.

    Raises:
        SceneError: other content, or no photo of its names.
    """
    try:
        entries = json.loads(path.read_text(encoding="utf-8-sig", errors="replace"))
        cameras = [_listed_camera(entry) for entry in entries]
        if not cameras:
            raise ValueError("there is no camera in it")
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as problem:
        raise SceneError(
            f"{path}: expected the cameras of 3D Gaussian splatting (a list with img_name, "
            f"position, rotation, fx, fy, width, height), got something else ({problem!r:.80})"
        ) from problem
    names = [camera.name for camera in cameras]
    found = find_photos(root, names, ("images", "input", "."), factor, str(path))
    photos = [
        Photo(
            name=camera.name,
            path=file,
            world_from_camera=camera.world_from_camera,
            lens=camera.lens,
            size=camera.size,
        )
        for camera, file in zip(cameras, found.paths, strict=True)
    ]
    return Capture(
        layout="3DGS cameras.json",
        where=str(path),
        photos=photos,
        notes=found.notes,
        shrunk=found.shrunk,
    )


def is_camera_list(path: Path) -> bool:
    """Whether a `cameras.json` is that of 3D Gaussian splatting; other programs have one too."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            head = file.read(4000)
    except OSError:
        return False
    return head.lstrip().startswith("[") and '"rotation"' in head and '"img_name"' in head


def _listed_camera(entry: Mapping[str, Any]) -> Photo:
    rotation = np.array(entry["rotation"], dtype=np.float64).reshape(3, 3)
    position = np.array(entry["position"], dtype=np.float64).reshape(3)
    size = (int(entry["width"]), int(entry["height"]))
    return Photo(
        name=str(entry["img_name"]),
        path=None,
        world_from_camera=opengl_pose(rotation.T, -rotation.T @ position),
        lens=LensDistortion(
            fx=float(entry["fx"]), fy=float(entry["fy"]), cx=size[0] / 2, cy=size[1] / 2
        ),
        size=size,
    )


def _nsvf_lens(path: Path) -> tuple[LensDistortion, tuple[int, int] | None]:
    """Intrinsics: a 4 x 4 matrix, or "f cx cy 0" on the first line and the size on the last."""
    lines = [
        line.split()
        for line in path.read_text("utf-8-sig", errors="replace").splitlines()
        if line.strip()
    ]
    try:
        rows = [[float(one) for one in line] for line in lines]
        if _is_matrix(rows):
            return _lens(rows[0][0], rows[1][1], rows[0][2], rows[1][2]), None
        focal, cx, cy = rows[0][:3]
        size = (int(rows[-1][1]), int(rows[-1][0])) if len(rows[-1]) == 2 else None
        return _lens(focal, focal, cx, cy), size
    except (ValueError, IndexError, OverflowError) as problem:
        raise SceneError(
            f"{path}: expected intrinsics as NSVF writes them (a 4 x 4 matrix, or focal length and "
            "principal point in the first line), got something else"
        ) from problem


def _is_matrix(rows: list[list[float]]) -> bool:
    widths = {len(row) for row in rows[:3]}
    return len(rows) >= 3 and widths in ({3}, {4}) and rows[0][1] == 0 and rows[1][0] == 0


def _lens(fx: float, fy: float, cx: float, cy: float) -> LensDistortion:
    if not (min(fx, fy) > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise ValueError("no lens")
    return LensDistortion(fx=fx, fy=fy, cx=cx, cy=cy)


def _nsvf_box(root: Path, name: str) -> Region | None:
    if not (root / name).is_file():
        return None
    path = inside(root, root / name)
    try:
        lower, upper = torch.from_numpy(_numbers(path, 6)).reshape(2, 3)
        return region_of_box(lower, upper)
    except InputError as problem:
        raise SceneError(f"{path}: {problem}") from problem


def _numbers(path: Path, count: int) -> NDArray[np.float64]:
    """The first numbers of a text file."""
    try:
        found = [
            float(one) for one in path.read_text("utf-8-sig", errors="replace").split()[:count]
        ]
    except ValueError as problem:
        raise SceneError(f"{path}: expected {count} numbers, got text ({problem})") from problem
    if len(found) != count:
        raise SceneError(f"{path}: expected {count} numbers, got {len(found)}")
    return np.array(found)


def _prefixes(names: list[str]) -> dict[str, list[str]] | None:
    starts = {start: [name for name in names if name.startswith(f"{start}_")] for start in "012"}
    if not starts["0"]:
        return None
    if not starts["2"]:
        return {"train": starts["0"], "test": starts["1"]}
    return {"train": starts["0"], "val": starts["1"], "test": starts["2"]}

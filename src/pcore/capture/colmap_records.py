"""What a model of COLMAP holds: cameras, images, points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcore.errors import SceneError
from pcore.geometry.lens_distortion import LensDistortion

Floats = NDArray[np.float64]
_PARAMETERS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
}


WrittenCamera = tuple[int, str, tuple[int, int], list[float]]
"""A camera as files have it, of a lens that may not be read: number, model, size, numbers."""


@dataclass(frozen=True, kw_only=True)
class ModelCamera:
    """A camera of a model: the size of its pictures and its lens in their pixels."""

    size: tuple[int, int]
    lens: LensDistortion


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelImage:
    """A registered image.

    Attributes:
        name: path below the folder of images.
        camera: number of its camera.
        quaternion: (4,) w x y z, camera_from_world, OpenCV axes.
        translation: (3,) of camera_from_world.
        places: (K, 2) pixels of its features.
        points: (K,) int64 number of the point each of them shows, -1 for none.
    """

    name: str
    camera: int
    quaternion: Floats
    translation: Floats
    places: Floats
    points: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelPoints:
    """Points by rows: numbers (N,), positions (N, 3), colours (N, 3) of 0 to 255, errors (N,)."""

    numbers: NDArray[np.int64]
    positions: Floats
    colors: Floats
    errors: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """Cameras that have images, images in the order of the file, points or None without a file."""

    cameras: dict[int, ModelCamera]
    images: list[ModelImage]
    points: ModelPoints | None


def model_camera(
    path: Path, model: str, size: tuple[int, int], numbers: list[float]
) -> ModelCamera:
    """Camera of a model by its name and numbers; SceneError for a lens that is not read."""
    names = _PARAMETERS.get(model)
    if names is None:
        raise SceneError(
            f"{path}: camera model {model} is not read; read are {', '.join(_PARAMETERS)}. "
            "Undistort the photos (COLMAP: image_undistorter), or run the mapper again with OPENCV"
        )
    if len(numbers) != len(names) or not np.isfinite(numbers).all() or min(size) < 1:
        raise SceneError(
            f"{path}: expected {len(names)} finite numbers for {model} and a size, got "
            f"{numbers[:12]} of {size[0]} x {size[1]} pixels"
        )
    values = dict(zip(names, numbers, strict=True))
    if "f" in values:
        values["fx"] = values["fy"] = values.pop("f")
    return ModelCamera(size=size, lens=LensDistortion(**values))


def model_points(rows: Sequence[tuple[int | float, ...]]) -> ModelPoints:
    """Points of rows: number, x, y, z, red, green, blue, error."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    return ModelPoints(
        numbers=np.array([row[0] for row in rows], dtype=np.int64),
        positions=table[:, 1:4],
        colors=table[:, 4:7],
        errors=table[:, 7],
    )

"""Models of COLMAP: cameras, images and points3D, binary or text (format of COLMAP 3.x and 4.x).

Rigs and frames of COLMAP 3.12 and later say nothing that images do not say.
"""

from __future__ import annotations

import struct
from pathlib import Path

from pcore.capture import colmap_binary, colmap_text
from pcore.capture.colmap_records import Model, model_camera
from pcore.errors import SceneError


def kind_of(folder: Path) -> str | None:
    """Ending of the files of a model, .bin before .txt; None where there is none."""
    for kind in (".bin", ".txt"):
        if all((folder / f"{name}{kind}").is_file() for name in ("cameras", "images")):
            return kind
    return None


def image_count(folder: Path) -> int:
    """How many images a model has registered; 0 where there is no model."""
    kind = kind_of(folder)
    if kind is None:
        return 0
    path = folder / f"images{kind}"
    if kind == ".txt":
        return sum(1 for _ in colmap_text.images(path))
    with path.open("rb") as file:
        head = file.read(8)
    return int(struct.unpack("<Q", head)[0]) if len(head) == 8 else 0


def model_files(folder: Path) -> list[Path]:
    """Files of a model: cameras, images, points3D, which need not be there.

    Raises:
        SceneError: no model.
    """
    kind = kind_of(folder)
    if kind is None:
        raise SceneError(f"{folder}: expected a model of COLMAP (cameras and images, .bin or .txt)")
    return [folder / f"{name}{kind}" for name in ("cameras", "images", "points3D")]


def read_model(folder: Path) -> Model:
    """Read a model.

    Raises:
        SceneError: truncated or damaged files, no image, or one of a lens that is not read (by its
            name).
    """
    paths = model_files(folder)
    read = colmap_binary if paths[0].suffix == ".bin" else colmap_text
    written = list(read.cameras(paths[0]))
    if not written:
        raise SceneError(f"{paths[0]}: expected cameras, got none; export the model again")
    images = list(read.images(paths[1]))
    if not images:
        raise SceneError(
            f"{paths[1]}: expected registered images, got an empty model; run COLMAP's mapper "
            "again, or give the folder of another model"
        )
    used = {one.camera for one in images}
    cameras = {
        number: model_camera(paths[0], model, size, numbers)
        for number, model, size, numbers in written
        if number in used
    }
    lost = next((one.name for one in images if one.camera not in cameras), None)
    if lost is not None:
        raise SceneError(f"{paths[1]}: image {lost} is of a camera that {paths[0].name} lacks")
    points = read.points(paths[2]) if paths[2].is_file() else None
    return Model(cameras=cameras, images=images, points=points)

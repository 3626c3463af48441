"""COLMAP's layout: a model in `sparse/0` or where else tools put it, and a folder of photos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pcore.capture.colmap_model import image_count, kind_of, model_files, read_model
from pcore.capture.colmap_records import Model, ModelImage
from pcore.capture.photo_folders import find_photos
from pcore.capture.photos import Capture, Photo, RawPoints, inside, pictures_in
from pcore.data.cut_off import why_unreadable
from pcore.data.scene import Skipped
from pcore.errors import SceneError

_PLACES = ("sparse", "colmap_sparse", "colmap/sparse", "distorted/sparse")
"""Where models lie, the first that has one is taken; of several in one place the largest."""
_LISTS = {"train": "train_list.txt", "val": "validation_list.txt", "test": "test_list.txt"}
_NO_POSE = "no pose in the model"
_POINTLESS = "points3D is missing or empty, so that only masks and axes say where the object is"
_FARTHEST = 1e15
"""No point of a model is farther from its origin; its square is no float32 any more."""
_OPENGL = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class FoundModel:
    """Where a model lies.

    Attributes:
        folder: of cameras, images and points3D.
        note: that others were left out, or "".
    """

    folder: Path
    note: str = ""


def find_model(root: Path) -> FoundModel | None:
    """The model of a capture: the largest in the first place that has one; None: none.

    COLMAP writes several when photos fall apart, and the first is not always the largest.
    """
    for place in _PLACES:
        found = largest_model(root / place, root)
        if found is not None:
            return found
    return FoundModel(folder=root) if kind_of(root) is not None else None


def largest_model(at: Path, root: Path) -> FoundModel | None:
    """The largest model in a folder or right below it, told of from `root` on; None: none."""
    children = sorted(at.iterdir()) if at.is_dir() else []
    candidates = [folder for folder in (at, *children) if kind_of(folder) is not None]
    if len(candidates) < 2:
        return FoundModel(folder=candidates[0]) if candidates else None
    counts = [image_count(folder) for folder in candidates]
    best = int(np.argmax(counts))
    others = ", ".join(
        f"{folder.name} ({count})"
        for folder, count in zip(candidates, counts, strict=True)
        if folder != candidates[best]
    )
    note = (
        f"{candidates[best].relative_to(root).as_posix()} is the largest model, with "
        f"{counts[best]} images; left out: {others}"
    )
    return FoundModel(folder=candidates[best], note=note)


def read_colmap(root: Path, found: FoundModel, factor: int) -> Capture:
    """Read a model and find its photos.

    Args:
        root: folder of the capture.
        found: its model.
        factor: down-scaling that is wished for; `images_N` is taken where it is there.

    Raises:
        SceneError: damaged files, a lens that is not read, no photo at its place.
    """
    within = root if found.folder.is_relative_to(root) else found.folder
    for path in model_files(found.folder):
        inside(within, path)
    model = read_model(found.folder)
    below = found.folder.relative_to(root).parts if found.folder.is_relative_to(root) else ()
    names = [image.name for image in model.images]
    base = ("input", "distorted/images") if "distorted" in below else ("images", "input", ".")
    photos = find_photos(root, names, base, factor, str(found.folder))
    sparse = raw_points(model)
    pointless = "" if sparse else f"{found.folder.name} is a model without points ({_POINTLESS})"
    return Capture(
        layout="COLMAP",
        where=str(found.folder),
        photos=[
            _photo(model, image, path)
            for image, path in zip(model.images, photos.paths, strict=True)
        ],
        sparse=sparse,
        splits=_listed(root, model.images),
        notes=[note for note in (found.note, pointless, *photos.notes) if note],
        skipped=_without_pose(root, photos.paths),
        shrunk=photos.shrunk,
    )


def opengl_pose(rotation: np.ndarray, translation: np.ndarray) -> torch.Tensor:
    """(4, 4) float64 world_from_camera, OpenGL axes, of camera_from_world with OpenCV axes."""
    pose = np.eye(4)
    with np.errstate(invalid="ignore", over="ignore"):  # Who has NaN is skipped later.
        pose[:3, :3] = rotation.T @ _OPENGL
        pose[:3, 3] = -rotation.T @ translation
    return torch.from_numpy(pose)


def _without_pose(root: Path, paths: Sequence[Path | None]) -> list[Skipped]:
    """Pictures beside those of the model that it has no pose for."""
    used = {path for path in paths if path is not None}
    beside = {one for folder in {path.parent for path in used} for one in pictures_in(folder)}
    twins = {path.with_suffix(""): path.name for path in used}
    left: list[Skipped] = []
    for path in sorted(beside - used):
        twin = twins.get(path.with_suffix(""))
        why = f"{_NO_POSE}; {twin} of the same name has one" if twin else None
        why = why or why_unreadable(path) or _NO_POSE
        left.append(Skipped(name=path.relative_to(root.resolve()).as_posix(), reason=why))
    return left


def _photo(model: Model, image: ModelImage, path: Path | None) -> Photo:
    camera = model.cameras[image.camera]
    w, x, y, z = image.quaternion
    with np.errstate(over="ignore"):
        length = float(np.linalg.norm(image.quaternion))
    sound = np.isfinite(length) and length > 0
    # A pose that is none becomes NaN, and the photo is skipped with that reason.
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix() if sound else np.full((3, 3), np.nan)
    return Photo(
        name=image.name,
        path=path,
        world_from_camera=opengl_pose(rotation, image.translation),
        lens=camera.lens,
        size=camera.size,
    )


def raw_points(model: Model) -> RawPoints | None:
    """Points of a model that are somewhere, with their sightings; None where there are none."""
    points = model.points
    if points is None or not len(points.numbers):
        return None
    finite = (np.abs(points.positions) < _FARTHEST).all(axis=1)  # Not of NaN.
    order = np.argsort(points.numbers[finite])
    numbers = points.numbers[finite][order]
    rows, photos, places = [], [], []
    for index, image in enumerate(model.images):
        row = np.searchsorted(numbers, image.points).clip(max=max(len(numbers) - 1, 0))
        known = (numbers[row] == image.points) if len(numbers) else np.zeros(0, dtype=bool)
        rows.append(row[known])
        photos.append(np.full(int(known.sum()), index))
        places.append(image.places[known])
    return RawPoints(
        positions=torch.from_numpy(points.positions[finite][order]),
        colors=torch.from_numpy(points.colors[finite][order] / 255).float(),
        errors=torch.from_numpy(points.errors[finite][order]).float(),
        points=torch.from_numpy(np.concatenate(rows).astype(np.int64)),
        photos=torch.from_numpy(np.concatenate(photos).astype(np.int64)),
        places=torch.from_numpy(np.concatenate(places)),
    )


def _listed(root: Path, images: Sequence[ModelImage]) -> Mapping[str, Sequence[str]] | None:
    """Splits of nerfstudio's lists of names; None without a list of training photos."""
    lists_at = {split: root / name for split, name in _LISTS.items() if (root / name).is_file()}
    paths = {split: inside(root, path) for split, path in lists_at.items()}
    if "train" not in paths:
        return None
    known = {image.name for image in images}
    lists = {
        split: [line.strip() for line in path.read_text("utf-8-sig", errors="replace").splitlines()]
        for split, path in paths.items()
    }
    found = {split: [name for name in names if name in known] for split, names in lists.items()}
    if not found["train"]:
        raise SceneError(
            f"{paths['train']}: none of its {len(lists['train'])} names is an image of the model"
        )
    return found

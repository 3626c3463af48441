"""The NeRF-Synthetic ("Blender") format: `transforms_{train,val,test}.json` and images."""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor

from pcore.data.images import ImageCache, ImageHeader, ImageSource, check_factor, read_header
from pcore.data.lens import Lens, LensEntry, Number, check_undistorted, lens_of
from pcore.data.scene import SplitsOnDemand, View
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.validation import parse, read_json

SPLITS = ("train", "val", "test")
_EXTENSIONS = ("", ".png", ".jpg", ".jpeg")

_Row = tuple[Number, Number, Number, Number]


class _FrameEntry(LensEntry):
    """One entry of `frames`; keys that other tools add are ignored."""

    transform_matrix: tuple[_Row, _Row, _Row, _Row]
    file_path: str | None = None


class _TransformsFile(LensEntry):
    """The file; frames are checked one by one, so that a message can name the frame."""

    camera_angle_x: Number | None = None
    frames: list[Any] = Field(min_length=1)
    w: Annotated[int, Field(ge=1)] | None = None
    h: Annotated[int, Field(ge=1)] | None = None


@dataclass(frozen=True, kw_only=True)
class PosedFrame:
    """A checked entry of a transforms file.

    Attributes:
        where: file and frame, the start of every message about it.
        name: unique in the file, safe as a file name.
        file_path: as written in the file, or None.
        world_from_camera: (4, 4) float32.
        lens: the file's, with what the frame says itself.
    """

    where: str
    name: str
    file_path: str | None
    world_from_camera: Tensor
    lens: Lens


@dataclass(frozen=True, kw_only=True)
class Transforms:
    """A checked transforms file.

    Attributes:
        path: the file.
        size: (width, height) when the file states it.
        frames: at least one.
    """

    path: Path
    size: tuple[int, int] | None
    frames: tuple[PosedFrame, ...]

    def camera(
        self, frame: PosedFrame, size: tuple[int, int], full: tuple[int, int] | None = None
    ) -> Camera:
        """Camera of one frame.

        Args:
            frame: one of `frames`.
            size: width and height of the picture.
            full: size of the image that intrinsics in pixels belong to; that of the file if None.

        Raises:
            SceneError: names file and frame: no such camera, or not known of which size.
        """
        full = full or self.size
        if full is None and frame.lens.in_pixels:
            raise SceneError(
                f"scene file {self.path}: has intrinsics in pixels ('fl_x', 'fl_y', 'cx', 'cy') "
                "of an image size that it does not say; add 'w' and 'h' to it"
            )
        try:
            return frame.lens.camera(frame.world_from_camera, size, full or size, frame.where)
        except InputError as problem:
            raise SceneError(f"{frame.where}: {problem}") from problem


def transforms_path(root: Path, split: str) -> Path:
    """Where the format keeps the cameras of a split."""
    return root / f"transforms_{split}.json"


def read_transforms(path: Path) -> Transforms:
    """Read and check a transforms file; images are not looked at."""
    content = parse(
        _TransformsFile,
        read_json(path, what="scene file", error=SceneError),
        where=f"scene file {path}",
        error=SceneError,
    )
    if (content.w is None) != (content.h is None):
        raise SceneError(f"scene file {path}: expected both 'w' and 'h' or neither, got one")
    check_undistorted(content, f"scene file {path}")
    lens = lens_of(content, content.camera_angle_x)
    entries = [_entry(path, index, item) for index, item in enumerate(content.frames)]
    if lens.angle_x is None and None in [lens.replaced(entry).fl_x for _, entry in entries]:
        raise SceneError(
            f"scene file {path}: 'camera_angle_x' is missing; add it, or 'fl_x', the focal length "
            "in pixels"
        )
    names = _names([entry.file_path for _, entry in entries])
    frames = tuple(
        PosedFrame(
            where=where,
            name=name,
            file_path=entry.file_path,
            world_from_camera=_pose(where, entry),
            lens=lens.replaced(entry),
        )
        for (where, entry), name in zip(entries, names, strict=True)
    )
    size = None if content.w is None or content.h is None else (content.w, content.h)
    return Transforms(path=path, size=size, frames=frames)


def load_splits(root: Path, *, factor: int, cache: ImageCache) -> SplitsOnDemand:
    """Splits that are in the folder, in the order train, val, test; each is read when it is needed.

    Then the headers of all its images are read, so that a missing file or a wrong size is found
    at once and not in the middle of training; pixels are decoded later.
    """
    return SplitsOnDemand(
        {
            split: partial(load_split, root, split, factor=factor, cache=cache)
            for split in SPLITS
            if transforms_path(root, split).is_file()
        }
    )


def load_split(root: Path, split: str, *, factor: int, cache: ImageCache) -> tuple[View, ...]:
    """Views of one split.

    Args:
        root: folder of the transforms file; images must lie inside it.
        split: "train", "val" or "test".
        factor: whole number by which images are down-scaled.
        cache: keeps decoded images.
    """
    transforms = read_transforms(transforms_path(root, split))
    expected = transforms.size
    views: list[View] = []
    for frame in transforms.frames:
        path = _image_path(root, frame)
        header = read_header(path)
        full = (header.width, header.height)
        expected = expected or full
        _check_size(transforms, frame, header, expected)
        check_factor(header.width, header.height, factor)
        size = (header.width // factor, header.height // factor)
        camera = transforms.camera(frame, size, full)
        source = ImageSource(path=path, header=header, factor=factor, cache=cache)
        views.append(View(name=frame.name, camera=camera, image=source))
    return tuple(views)


def _entry(path: Path, index: int, item: object) -> tuple[str, _FrameEntry]:
    label = item.get("file_path") if isinstance(item, dict) else None
    where = f"scene file {path}, frame {index}" + (f" ({label})" if label else "")
    entry = parse(_FrameEntry, item, where=where, error=SceneError)
    check_undistorted(entry, where)
    return where, entry


def _pose(where: str, entry: _FrameEntry) -> Tensor:
    pose = torch.tensor(entry.transform_matrix, dtype=torch.float64)
    if not bool(torch.isfinite(pose).all()):
        raise SceneError(
            f"{where}: expected finite numbers in 'transform_matrix', got NaN or infinity; "
            "remove the frame or estimate its pose again"
        )
    if pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise SceneError(
            f"{where}: expected the last row of 'transform_matrix' to be 0 0 0 1, "
            f"got {pose[3].tolist()}; is the matrix transposed?"
        )
    return pose.float()


def _names(file_paths: list[str | None]) -> list[str]:
    """Stem of each path made safe as a file name; the index is added where stems repeat."""
    stems = [
        re.sub(r"[^\w.-]", "_", PurePosixPath(path or "").stem).lstrip(".") or "frame"
        for path in file_paths
    ]
    counts = Counter(stems)
    return [stem if counts[stem] == 1 else f"{stem}_{i:04d}" for i, stem in enumerate(stems)]


def _image_path(root: Path, frame: PosedFrame) -> Path:
    if not frame.file_path:
        raise SceneError(f"{frame.where}: 'file_path' is missing; name the frame's image")
    if "\0" in frame.file_path:
        raise SceneError(f"{frame.where}: 'file_path' contains a zero byte; write a plain path")
    home = root.resolve()
    candidates = [Path(f"{root / frame.file_path}{end}") for end in _EXTENSIONS]
    for candidate in candidates:
        resolved = candidate.resolve()
        if not resolved.is_relative_to(home):
            raise SceneError(
                f"{frame.where}: 'file_path' leaves the scene's folder {home} (it leads to "
                f"{resolved}); scenes may only read their own files: copy the image into the folder"
            )
        # Names that are too long are an error to pathlib, and to users a file that is not there.
        if os.path.isfile(resolved):  # noqa: PTH113
            return resolved
    raise SceneError(
        f"{frame.where}: no image at {candidates[0]} (nor with {', '.join(_EXTENSIONS[1:])} added);"
        " put it there or remove the frame"
    )


def _check_size(
    transforms: Transforms, frame: PosedFrame, header: ImageHeader, expected: tuple[int, int]
) -> None:
    if (header.width, header.height) != expected:
        source = "'w' and 'h' of the file" if transforms.size else "the first image"
        raise SceneError(
            f"{frame.where}: expected an image of {expected[0]} x {expected[1]} pixels like "
            f"{source}, got {header.width} x {header.height}; resize it or mend the scene file"
        )

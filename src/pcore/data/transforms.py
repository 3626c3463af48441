"""Transforms files: `transforms_*.json` of NeRF-Synthetic and of tools that write the same form."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from pcore.data.foreign import foreign_json, foreign_matrix, foreign_text
from pcore.data.lens import Lens, lens_of
from pcore.data.lens_entry import LensEntry, Number, bend_of, check_pinhole, check_projection
from pcore.data.transform_keys import (
    USED_AT_TOP,
    USED_IN_CAPTURES,
    USED_IN_FRAME,
    check_keys,
    note_of_unknown,
)
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.validation import parse, parse_json, read_text

_LABEL = 120
"""Letters of a frame's path that messages show."""
_Row = tuple[Number, Number, Number, Number]


class _FrameEntry(LensEntry):
    """One entry of `frames`."""

    transform_matrix: tuple[_Row, _Row, _Row, _Row]
    file_path: str | None = None


class _TransformsFile(BaseModel):
    """The list of frames; they are checked one by one, so that a message can name the frame."""

    model_config = ConfigDict(extra="ignore")
    frames: list[Any] = Field(min_length=1)


@dataclass(frozen=True, kw_only=True)
class PosedFrame:
    """A checked entry of a transforms file.

    Attributes:
        where: file and frame, the start of every message about it.
        name: unique in the file, safe as a file name.
        file_path: as written in the file, or None.
        mask_path: as written in the file, or None.
        world_from_camera: (4, 4) float64, as in the file.
        lens: the file's, with what the frame says itself.
        bend: coefficients of distortion that are not zero, by name.
        time: time stamp of D-NeRF's form, as in the file; None where it says none.
    """

    where: str
    name: str
    file_path: str | None
    mask_path: str | None
    world_from_camera: Tensor
    lens: Lens
    bend: Mapping[str, float] = field(default_factory=dict[str, float])
    time: float | None = None


@dataclass(frozen=True, kw_only=True)
class Transforms:
    """A checked transforms file.

    Attributes:
        path: the file.
        frames: at least one.
        notes: what is odd about it and was not refused, a sentence each.
        content: the file as it is written, for the keys that only some readers use.
    """

    path: Path
    frames: tuple[PosedFrame, ...]
    notes: tuple[str, ...] = ()
    content: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def camera(
        self, frame: PosedFrame, size: tuple[int, int], full: tuple[int, int] | None = None
    ) -> Camera:
        """Camera of one frame.

        Args:
            frame: one of `frames`.
            size: width and height of the picture.
            full: size of the image that intrinsics in pixels belong to; what the file says if None.

        Raises:
            SceneError: names file and frame: no such camera, or not known of which size.
        """
        full = full or frame.lens.full_size
        if full is None and frame.lens.in_pixels:
            raise SceneError(
                f"scene file {self.path}: has intrinsics in pixels ('fl_x', 'fl_y', 'cx', 'cy') "
                "of an image size that it does not say; add 'w' and 'h' to it"
            )
        pose = frame.world_from_camera.float()
        try:
            return frame.lens.camera(pose, size, full, frame.where)
        except InputError as problem:
            raise SceneError(f"{frame.where}: {problem}") from problem


def read_transforms(path: Path, *, capture: bool = False) -> Transforms:
    """Read and check a transforms file; images are not looked at.

    Args:
        path: the file.
        capture: it is of real photos. Lenses may bend lines, matrices may lack their last row and
            hold NaN, for whoever skips such frames.

    Raises:
        SceneError: missing, damaged or inconsistent, a file of another program, a projection or a
            key about the camera that is not read.
    """
    where = f"scene file {path}"
    raw = _read(path, where)
    frames = parse(_TransformsFile, raw, where=where, error=SceneError).frames
    top = parse(LensEntry, raw, where=where, error=SceneError)
    used = USED_AT_TOP | USED_IN_CAPTURES if capture else USED_AT_TOP
    unknown = check_keys(raw, used, where)
    check_lens = check_projection if capture else check_pinhole
    check_lens(top, where)
    lens = lens_of(top, where)
    entries: list[tuple[str, _FrameEntry]] = []
    in_frames: list[str] = []
    for index, item in enumerate(frames):
        place, entry = _entry(path, index, _with_last_row(item) if capture else item)
        check_lens(entry, place)
        in_frames += check_keys(item, USED_IN_FRAME, place)
        entries.append((place, entry))
    names = _names([entry.file_path for _, entry in entries])
    posed = tuple(
        PosedFrame(
            where=place,
            name=name,
            file_path=entry.file_path,
            mask_path=entry.mask_path or top.mask_path,
            world_from_camera=_pose(place, entry, finite=not capture),
            lens=_lens(lens, entry, place, where),
            bend=bend_of(top, entry),
            time=time_of(item),
        )
        for item, (place, entry), name in zip(frames, entries, names, strict=True)
    )
    note = note_of_unknown(unknown, in_frames, len(frames))
    said = () if note is None else (f"{path.name}: {note}",)
    return Transforms(path=path, frames=posed, notes=said, content=raw)


def time_of(frame: Any) -> float | None:
    """Time stamp of an entry of `frames`; None where it has no finite number there."""
    value = cast("Mapping[str, Any]", frame).get("time") if isinstance(frame, dict) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:  # An integer beyond what floats hold.
        return None


def _read(path: Path, where: str) -> Mapping[str, Any]:
    """The object of the file; SceneError when it is something else."""
    text = read_text(path, where=where, error=SceneError)
    foreign = foreign_text(text)
    content = None if foreign else parse_json(text, where=where, error=SceneError)
    foreign = foreign or foreign_json(content)
    if foreign is not None:
        raise SceneError(
            f'{where}: expected a transforms file ({{"camera_angle_x": ..., "frames": [...]}}), '
            f"got {foreign.what}; {foreign.advice}"
        )
    if isinstance(content, dict):
        return cast("Mapping[str, Any]", content)
    # Only for its message, which every other wrong type gets too.
    parse(_TransformsFile, content, where=where, error=SceneError)
    raise AssertionError("a file that is no object was taken for one")


def _entry(path: Path, index: int, item: Any) -> tuple[str, _FrameEntry]:
    frame = cast("Mapping[str, Any]", item if isinstance(item, dict) else {})
    label = frame.get("file_path")
    shown = str(label)[:_LABEL].encode(errors="replace").decode()
    where = f"scene file {path}, frame {index}" + (f" ({shown})" if label else "")
    odd = foreign_matrix(frame)
    if odd is not None:
        raise SceneError(f"{where}: {odd}")
    entry = parse(_FrameEntry, item, where=where, error=SceneError)
    return where, entry


def _with_last_row(item: Any) -> Any:
    """The frame with 0 0 0 1 below a matrix of 3 rows, which some tools leave out."""
    frame = cast("dict[str, Any]", item) if isinstance(item, dict) else {}
    matrix = cast("list[Any]", frame.get("transform_matrix"))
    if not isinstance(matrix, list) or len(matrix) != 3:  # pyright: ignore[reportUnnecessaryIsInstance]
        return item
    return {**frame, "transform_matrix": [*matrix, [0.0, 0.0, 0.0, 1.0]]}


def _lens(top: Lens, entry: _FrameEntry, place: str, where: str) -> Lens:
    lens = top.replaced(entry, place)
    if not (lens.x.is_given or lens.y.is_given):
        raise SceneError(
            f"{where}: 'camera_angle_x' is missing; add it, or 'fl_x', the focal length in pixels"
        )
    if None in lens.size and lens.size != (None, None):
        raise SceneError(f"{place}: expected both 'w' and 'h' or neither, got one")
    return lens


def _pose(where: str, entry: _FrameEntry, *, finite: bool) -> Tensor:
    pose = torch.tensor(entry.transform_matrix, dtype=torch.float64)
    known = bool(torch.isfinite(pose).all())
    if finite and not known:
        raise SceneError(
            f"{where}: expected finite numbers in 'transform_matrix', got NaN or infinity; "
            "remove the frame or estimate its pose again"
        )
    if known and pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise SceneError(
            f"{where}: expected the last row of 'transform_matrix' to be 0 0 0 1, "
            f"got {pose[3].tolist()}; is the matrix transposed?"
        )
    return pose


def _names(file_paths: list[str | None]) -> list[str]:
    """Stem of each path made safe as a file name; the index is added where stems repeat."""
    stems = [
        re.sub(r"[^\w.-]", "_", Path((path or "").replace("\\", "/")).stem).lstrip(".") or "frame"
        for path in file_paths
    ]
    counts = Counter(stems)
    return [stem if counts[stem] == 1 else f"{stem}_{i:04d}" for i, stem in enumerate(stems)]

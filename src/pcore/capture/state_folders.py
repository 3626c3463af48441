"""Where the views of a rendered scene and of its deformed states are written.

A state is a sub-folder of the scene with `transforms_test.json`; a sub-folder as Neural Editor's
deformed scenes have it, with `views_test/transforms.json`; `end` of a PAPR-in-Motion pair; or a
time stamp of the scene's own files, as D-NeRF writes them: `t0.25` are all frames of "time" 0.25.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pcore.data.blender import SplitFile, same_time, splits_in, transforms_path
from pcore.data.transforms import time_of
from pcore.errors import SceneError
from pcore.validation import parse_json, read_text

START, END = "start", "end"
_LEAST = 2
_VIEWS = {"train": "views_train", "test": "views_test"}
"""Folders of Neural Editor's deformed scenes; paths of their images start one folder above."""

Splits = Mapping[str, SplitFile]


@dataclass(frozen=True, kw_only=True)
class RenderedFiles:
    """The files of a rendered scene.

    Attributes:
        root: folder of the canonical views.
        splits: those of the canonical views, by name.
        states: splits by state; states without test views are those of a sequence in time.
        note: what is special about it, or "".
    """

    root: Path
    splits: Splits
    states: Mapping[str, Splits]
    note: str = ""


def is_pair(folder: Path) -> bool:
    """Whether a folder holds a pair of states, as PAPR in Motion has them."""
    return all(transforms_path(folder / side, "train").is_file() for side in (START, END))


def files_of(folder: Path) -> RenderedFiles:
    """Look where a scene's views are; of time stamps the first of the training views is canonical.

    Raises:
        SceneError: a sequence in time in which one time stamp has too few training views, or frames
            without one.
    """
    if is_pair(folder):
        splits = splits_in(folder / START)
        states = {END: splits_in(folder / END)}
        return RenderedFiles(root=folder / START, splits=splits, states=states)
    states = state_files(folder)
    first = _first_time(folder)
    if first is None:
        return RenderedFiles(root=folder, splits=splits_in(folder), states=states)
    with_first = {
        split: file for split, file in splits_in(folder, first).items() if _has(file.path, first)
    }
    name = _name(first)
    note = (
        f"a sequence in time: the views of time {first:g} are learned, {len(states)} later states "
        f"are scored (the first is {next(iter(states), 'none')}, this one {name})"
    )
    return RenderedFiles(root=folder, splits=with_first, states=states, note=note)


def state_files(folder: Path) -> Mapping[str, Splits]:
    """Splits of all deformed states of a scene's folder, by name: sub-folders, then time stamps."""
    if is_pair(folder):
        return {END: splits_in(folder / END)}
    found = {child.name: _of_folder(child) for child in sorted(folder.iterdir()) if child.is_dir()}
    states = {name: splits for name, splits in found.items() if "test" in splits}
    times = {split: _times(file.path) for split, file in splits_in(folder).items()}
    stamps = sorted({time for known in times.values() for time in known if time is not None})
    if len({_name(time) for time in stamps}) < 2:
        return states
    first = min((time for time in times.get("train", ()) if time is not None), default=None)
    for time in stamps:
        if first is None or not same_time(time, first):
            splits = splits_in(folder, time)
            states[_name(time)] = {k: v for k, v in splits.items() if _has(v.path, time)}
    return states


def _of_folder(folder: Path) -> Splits:
    if transforms_path(folder, "test").is_file():
        return splits_in(folder)
    paths = {split: folder / name / "transforms.json" for split, name in _VIEWS.items()}
    return {k: SplitFile(root=folder, path=path) for k, path in paths.items() if path.is_file()}


def _first_time(folder: Path) -> float | None:
    """The first time stamp of the training views; None for a scene that does not change."""
    path = transforms_path(folder, "train")
    known = {split: _times(file.path) for split, file in splits_in(folder).items()}
    if len({_name(t) for times in known.values() for t in times if t is not None}) < 2:
        return None
    times = known.get("train", ())
    stamped = [time for time in times if time is not None]
    if len(stamped) < len(times) or not stamped:
        raise SceneError(
            f"scene file {path}: expected 'time' in every frame of a sequence in time or in none, "
            f"got it in {len(stamped)} of {len(times)}"
        )
    first = min(stamped)
    count = sum(same_time(time, first) for time in stamped)
    if count < _LEAST:
        raise SceneError(
            f"scene file {path}: expected several training views of the first time stamp, from "
            f"which the object is learned, got {count} of {len(times)} frames with time {first:g}. "
            "A sequence with one camera for each time has no canonical set of views; if the object "
            "does not move, remove 'time' from the frames"
        )
    return first


def _has(path: Path, time: float) -> bool:
    return any(same_time(one, time) for one in _times(path))


def _times(path: Path) -> tuple[float | None, ...]:
    """Time stamps of the frames of a file; none of a file that the reader will refuse."""
    where = f"scene file {path}"
    try:
        text = read_text(path, where=where, error=SceneError)
        content: Any = parse_json(text, where=where, error=SceneError) if '"time"' in text else None
    except SceneError:
        return ()
    frames: Any = cast("dict[str, Any]", content).get("frames") if isinstance(content, dict) else ()
    return tuple(map(time_of, cast("list[Any]", frames))) if isinstance(frames, list) else ()


def _name(time: float) -> str:
    return f"t{time:.6g}"

"""Where the views of a rendered scene and of its deformed states are written.

A state is a sub-folder of the scene with `transforms_test.json`; a sub-folder as Neural Editor's
deformed scenes have it, with `views_test/transforms.json`; `end` of a PAPR-in-Motion pair; or a
time stamp of the scene's own files, as D-NeRF writes them: `t0.25` are all frames of "time" 0.25.
The first time of the training views is canonical, and a state as well where it has a single photo.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from pcore.data.blender import SplitFile, same_time, splits_in, transforms_path
from pcore.data.transforms import time_of
from pcore.errors import SceneError
from pcore.validation import parse_json, read_text

START, END = "start", "end"
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
        SceneError: a sequence in time in which frames have no time stamp.
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
    note = (
        f"a sequence in time: the views of time {first:g} are learned, {len(states)} later states "
        f"are scored (the first is {next(iter(states), 'none')}, this one {_name(first)})"
    )
    if _name(first) in states:
        note = (
            f"a sequence in time with one photo of the first time, {first:g}, from which no object "
            f"can be learned: its {len(states)} states pose and score a run of the same object "
            "that was learned elsewhere (pcore fit --photos, pcore eval --against)"
        )
    return RenderedFiles(root=folder, splits=with_first, states=states, note=note)


def state_files(folder: Path) -> Mapping[str, Splits]:
    """Splits of all deformed states of a scene's folder, by name: sub-folders, then time stamps."""
    if is_pair(folder):
        return {END: splits_in(folder / END)}
    found = {child.name: _of_folder(child) for child in sorted(folder.iterdir()) if child.is_dir()}
    states = {name: splits for name, splits in found.items() if "test" in splits}
    files = splits_in(folder)
    times = {split: _times(file.path) for split, file in files.items()}
    stamps = sorted({time for known in times.values() for time in known if time is not None})
    if len({_name(time) for time in stamps}) < 2:
        return states
    known = [time for time in times.get("train", ()) if time is not None]
    learned = [time for time in known if same_time(time, min(known))]
    for time in stamps:
        # One photo teaches nothing, so that its time is a state like the others.
        if len(learned) < 2 or not same_time(time, learned[0]):
            states[_name(time)] = {
                split: replace(file, time=time)
                for split, file in files.items()
                if any(same_time(one, time) for one in times[split])
            }
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
    return min(stamped)


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

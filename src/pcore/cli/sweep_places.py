"""Files and folders that a plan names: seen from the plan's folder, there, and what they hold."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from pcore.capture.layouts import VIDEO, layout_of
from pcore.capture.state_folders import is_pair
from pcore.data.image_paths import ENDINGS
from pcore.errors import InputError
from pcore.files.run_record import begun
from pcore.sweep.sweep_tables import SWEEP_FILE
from pcore.sweep.sweep_trial import SCENE, Trial

_EDIT = "edit"
"""Its files name others."""
_NAMED = "pictures"
"""Its values are NAME=PLACE."""
_WORDS: dict[tuple[str, str], tuple[str, ...]] = {
    ("train", "init"): ("hull", "grid", "sparse", "views"),
    ("train", "masks"): ("auto", "trained", "none"),
    ("eval", _EDIT): (),
    ("eval", "baseline"): (),
    ("compare", _NAMED): (),
}
"""Options that name a place, by verb, and what else they may be."""
_LONGEST = 250
"""Bytes of a file's name in an edit."""
_READ = (*ENDINGS, ".json", ".npy", ".npz", ".bin", ".ply")
"""Endings of what is read in a folder: photos and masks, cameras, points and depth."""
_TEXTS = "cameras images points3d frames rigs train_list validation_list test_list intrinsics bbox"
"""Text files of COLMAP and NSVF; NSVF's poses lie in a folder of their own."""


def placed(trials: Sequence[Trial], beside: Path) -> list[Trial]:
    """Trials whose options name the places that a plan means, absolute.

    Args:
        trials: as `trials_of` lists them.
        beside: folder that the plan's paths are seen from.
    """
    found: list[Trial] = []
    for one in trials:
        where = f"plan: setting {one.setting!r}"
        verbs = {
            verb: {
                key: _placed(verb, key, value, beside, f"{where}, {verb}: '{key}'")
                for key, value in options.items()
            }
            for verb, options in one.verbs.items()
        }
        found.append(replace(one, verbs=verbs))
    return found


def with_contents(trials: Sequence[Trial]) -> list[Trial]:
    """Trials of `placed` that know what the files hold that they read.

    Scenes, masks, edits and what these name.

    Raises:
        OSError: one cannot be read.
    """
    hashes = cache(_hashes)  # Trials share scenes.
    return [
        replace(
            one,
            inputs={
                f"{what}{name}": value
                for what, place in _inputs(one)
                for name, value in hashes(place).items()
            },
        )
        for one in trials
    ]


def _inputs(trial: Trial) -> Iterator[tuple[str, Path]]:
    """What each place of a trial is to it, and the place."""
    scene = trial.scene_folder
    if scene.is_file() or not is_pair(scene):
        layout = layout_of(scene)
        scene = layout.path if layout.name == VIDEO else layout.root
    yield SCENE, scene
    for verb, options in trial.verbs.items():
        for key, value in options.items():
            name = key.replace("-", "_").lstrip("_")
            words = _WORDS.get((verb, name))
            for one in value if isinstance(value, list) else [value]:
                if words is not None and isinstance(one, str) and one not in words:
                    place = one.rpartition("=")[2] if name == _NAMED else one
                    yield place, Path(place)
                    if name == _EDIT:
                        yield from ((str(file), file) for file in _named_by(Path(place)))


def _named_by(edit: Path) -> list[Path]:
    """Files that an edit file names: cages, meshes, arrays."""

    def texts(value: Any) -> Iterator[str]:
        if isinstance(value, str):
            yield value
        elif isinstance(value, (dict, list)):
            for one in value.values() if isinstance(value, dict) else value:
                yield from texts(one)

    try:
        content = json.loads(edit.read_bytes())
    except ValueError:
        return []  # The verb says what is wrong with it.
    # Longer texts are no names, and would be errors of the system.
    named = (edit.parent / one for one in texts(content) if len(one.encode()) < _LONGEST)
    return [path for path in named if path.is_file()]


def _hashes(place: Path) -> dict[str, str]:
    """Of the content of a file, or of all files of a folder that may be read as data."""
    files = {f"/{name}": path for name, path in _data_in(place)} if place.is_dir() else {"": place}
    if begun(place):
        files = {f"/{path.name}": path for path in sorted(place.glob("*.safetensors"))}
    found: dict[str, str] = {}
    for name, path in files.items():
        with path.open("rb") as file:
            found[name] = hashlib.file_digest(file, "blake2b").hexdigest()[:16]
    return found


def _data_in(folder: Path, above: tuple[Path, ...] = ()) -> Iterator[tuple[str, Path]]:
    """Data below a folder, by path seen from it; nothing that pcore has written there."""
    above = (*above, folder.resolve())
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if not path.is_dir():
            if path.is_file() and _is_data(path):
                yield path.name, path
        # A link may lead back to a folder that it lies in.
        elif path.resolve() not in above and not begun(path) and not (path / SWEEP_FILE).is_file():
            yield from ((f"{path.name}/{name}", file) for name, file in _data_in(path, above))


def _is_data(path: Path) -> bool:
    if path.suffix.lower() == ".txt":
        return path.stem.lower() in _TEXTS.split() or path.parent.name == "pose"
    return path.suffix.lower() in _READ


def _placed(verb: str, key: str, value: Any, beside: Path, where: str) -> Any:
    name = key.replace("-", "_").lstrip("_")
    words = _WORDS.get((verb, name))
    if words is None or isinstance(value, dict):
        return value
    if isinstance(value, list):
        return [_placed(verb, key, one, beside, where) for one in value]
    if not isinstance(value, str) or value in words:
        return value
    head, equals, place = value.rpartition("=") if name == _NAMED else ("", "", value)
    path = (beside / place).resolve()
    if not path.exists():
        other = f", or one of {', '.join(words)}" if words else ""
        raise InputError(
            f"{where}: expected a file or folder, seen from the plan's own folder{other}; got "
            f"{value!r}: there is no {path}"
        )
    return f"{head}{equals}{path}"

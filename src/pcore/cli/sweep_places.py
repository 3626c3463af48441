"""Files and folders that a plan names: seen from the plan's folder, there, and what they hold."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from pcore.capture.layouts import VIDEO, layout_of
from pcore.capture.state_folders import is_pair
from pcore.errors import InputError
from pcore.files.run_record import begun
from pcore.sweep.sweep_tables import SWEEP_FILE
from pcore.sweep.sweep_trial import SCENE, Trial

_WORDS: dict[tuple[str, str], tuple[str, ...]] = {
    ("train", "init"): ("hull", "grid", "sparse", "views"),
    ("train", "masks"): ("auto", "trained", "none"),
    ("eval", "edit"): (),
    ("compare", "pictures"): (),
}
"""Options that name a place, by verb, and what else they may be."""
_NAMED = "pictures"
"""Its values are NAME=PLACE."""


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
    """Trials of `placed` that know what the files hold that they read: scenes, edits, masks.

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


def _hashes(place: Path) -> dict[str, str]:
    """Of the content of a file, or of all files of a folder but those that pcore has written."""
    if place.is_file():
        with place.open("rb") as file:
            return {"": hashlib.file_digest(file, "blake2b").hexdigest()[:16]}
    found: dict[str, str] = {}
    for path in sorted(place.iterdir()):
        ours = path.is_dir() and (begun(path) or (path / SWEEP_FILE).is_file())
        if not path.name.startswith(".") and path.exists() and not ours:
            found |= {f"/{path.name}{name}": value for name, value in _hashes(path).items()}
    return found


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

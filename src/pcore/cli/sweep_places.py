"""Files and folders that the options of a plan name: seen from the plan's folder, and there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pcore.errors import InputError
from pcore.sweep.sweep_trial import Trial

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

"""Scores of a sweep's trials, as `pcore eval` and `pcore compare` wrote them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcore.errors import InputError
from pcore.evaluation.runner import Value
from pcore.evaluation.summary import StateMean
from pcore.evaluation.tables import SUMMARY_FILE, numbers_of, read_summary
from pcore.sweep.sweep_trial import Trial

EVAL, COMPARE = "eval", "compare"
"""Folders of a trial's results."""
_COMPARED = "standard"
"""The protocol of `pcore compare`."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """One method in one state of one trial.

    Attributes:
        scene: name in the plan.
        setting: the setting's name.
        seed: of the trial.
        method: as the verb calls it.
        state: of the scene.
        protocol: how pictures were compared.
        scores: metric -> mean over the test views; None where it is not defined.
    """

    scene: str
    setting: str
    seed: int
    method: str
    state: str
    protocol: str
    scores: Mapping[str, Value]


def scores_of(trials: Sequence[Trial]) -> list[Score]:
    """Read the scores of finished trials, in their order.

    Raises:
        InputError: a file is missing or damaged.
    """
    return [
        Score(
            scene=trial.scene,
            setting=trial.setting,
            seed=trial.seed,
            method=one.method,
            state=one.state,
            protocol=one.protocol,
            scores=one.scores,
        )
        for trial in trials
        for one in _means(trial)
    ]


def _means(trial: Trial) -> list[StateMean]:
    found: list[StateMean] = []
    if "eval" in trial.verbs:
        found += read_summary(trial.folder / EVAL / SUMMARY_FILE)[0]
    if "compare" in trial.verbs:
        found += _compared(trial.folder / COMPARE / "compare.json")
    return found


def _compared(path: Path) -> list[StateMean]:
    """Means of `pcore compare`; methods trained in two ways keep the way in their name."""
    try:
        record: dict[str, Any] = json.loads(path.read_bytes())
        return [
            StateMean(
                method=_method(line),
                state=state,
                kind="analytic",
                protocol=_COMPARED,
                views=0,
                scores=numbers_of({name: cell["value"] for name, cell in cells.items()}),
            )
            for line in record["methods"]
            for state, cells in line["cells"].items()
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: expected results that `pcore compare` wrote, got something else; delete the "
            "folder and give the same command again"
        ) from error


def _method(line: Mapping[str, Any]) -> str:
    way = line["setting"]
    return line["name"] if way == "given" else f"{line['name']} ({way})"


def notes_of(trials: Sequence[Trial]) -> list[str]:
    """What `pcore compare` says of finished trials: above all, which methods failed."""
    return [
        f"{trial.name}: {note}"
        for trial in trials
        if "compare" in trial.verbs
        for note in json.loads((trial.folder / COMPARE / "compare.json").read_bytes())["notes"]
    ]

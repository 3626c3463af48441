"""The files of a sweep: scores of every trial, means, differences, and all of it as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pcore.evaluation.runner import Value
from pcore.evaluation.tables import csv_of, write_json
from pcore.files.atomic import write_atomically
from pcore.files.provenance import pcore_version
from pcore.sweep.spread import PairedDifference, Spread, VariantMean
from pcore.sweep.sweep_scores import Score
from pcore.sweep.sweep_trial import TrialResult

SWEEP_FILE = "sweep.json"
RESULTS_FILE, MEANS_FILE, DIFFERENCES_FILE = "results.csv", "means.csv", "differences.csv"
TABLES = (SWEEP_FILE, RESULTS_FILE, MEANS_FILE, DIFFERENCES_FILE)
"""All of them."""
_SCORE_KEYS = ("scene", "setting", "seed", "method", "state", "protocol")
_MEAN_KEYS = ("setting", "method", "scene", "state", "protocol")
_DIFFERENCE_KEYS = ("setting", "method", "against_setting", "against_method", "state", "protocol")


def write_sweep(
    folder: Path,
    results: Sequence[TrialResult],
    scores: Sequence[Score],
    means: Sequence[VariantMean],
    differences: Sequence[PairedDifference],
    *,
    trials: int,
) -> None:
    """Write all files of a sweep; they depend on nothing but what trials computed.

    Args:
        folder: of the sweep.
        results: of the trials that have ended so far.
        scores: of those that have not failed.
        means: of the scores.
        differences: of the scores.
        trials: how many there are in all.

    Raises:
        OSError: a file cannot be written; old ones are then as they were.
    """
    rows = [({key: getattr(one, key) for key in _SCORE_KEYS}, one.scores) for one in scores]
    write_atomically(folder / RESULTS_FILE, _csv(_SCORE_KEYS, rows))
    rows = [
        ({key: getattr(one, key) for key in _MEAN_KEYS}, _columns(one.figures)) for one in means
    ]
    write_atomically(folder / MEANS_FILE, _csv(_MEAN_KEYS, rows))
    rows = [(_difference_keys(one), _columns(one.figures)) for one in differences]
    write_atomically(folder / DIFFERENCES_FILE, _csv(_DIFFERENCE_KEYS, rows))
    record = {
        "pcore": pcore_version(),
        "status": "finished" if len(results) == trials else "not finished",
        "trials": [{"trial": one.trial.name, "failed": one.failed} for one in results],
        "scores": [asdict(one) for one in scores],
        "means": [asdict(one) for one in means],
        "differences": [
            {**_difference_keys(one), "figures": _with_intervals(one.figures)}
            for one in differences
        ],
    }
    write_json(folder / SWEEP_FILE, record)


def _difference_keys(one: PairedDifference) -> dict[str, str]:
    return {
        "setting": one.setting,
        "method": one.method,
        "against_setting": one.against[0],
        "against_method": one.against[1],
        "state": one.state,
        "protocol": one.protocol,
    }


def _columns(figures: Mapping[str, Spread]) -> dict[str, Value]:
    """Three columns for each metric."""
    return {
        name + end: value
        for name, one in figures.items()
        for end, value in (("", one.mean), ("_spread", one.spread), ("_count", one.count))
    }


def _with_intervals(figures: Mapping[str, Spread]) -> dict[str, Any]:
    return {name: {**asdict(one), "interval_95": one.interval()} for name, one in figures.items()}


def _csv(
    keys: Sequence[str], rows: Sequence[tuple[Mapping[str, Any], Mapping[str, Value]]]
) -> bytes:
    """One line per row."""
    columns = list(dict.fromkeys(name for _, figures in rows for name in figures))
    lines = [
        [names[key] for key in keys] + [figures.get(name) for name in columns]
        for names, figures in rows
    ]
    return csv_of([*keys, *columns], lines)

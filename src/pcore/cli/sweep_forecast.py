"""What `pcore sweep --dry-run` shows: the trials, and how long they will take."""

from __future__ import annotations

import json
import math
import statistics
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from pcore.cli.console import say
from pcore.cli.layout import Sheet, room, sheet_lines
from pcore.cli.sweep_processes import reason_in
from pcore.cli.sweep_verbs import RUN, process_words, words_of
from pcore.demo.machine import clock
from pcore.errors import TrainingError
from pcore.files.run_folder import LOG_FILE
from pcore.sweep.sweep_trial import Trial, TrialResult

_WATCH = 10.0
"""Seconds of training after its first step, when all is compiled, that tell how fast it is."""
_PATIENCE = 120.0
"""Seconds after which a training that has not begun tells nothing."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """Seconds of one trial; None where nothing is known. `whole`: of all verbs, not of training."""

    seconds: float | None
    whole: bool


def show_plan(
    console: Console, trials: Sequence[Trial], done: Sequence[TrialResult], workers: int
) -> None:
    """Print all trials with what each runs, and the time that what is left will take."""
    finished = {one.trial.name for one in done}
    left = [one for one in trials if one.name not in finished]
    known = {name: _forecast(name, left, done) for name in dict.fromkeys(t.setting for t in left)}
    rows = tuple(
        ((one.scene, one.setting, str(one.seed)), (_told(one, finished, known),)) for one in trials
    )
    keys = ("scene", "setting", "seed")
    sheet = Sheet(title=f"{len(trials)} trials", keys=keys, columns=("predicted time",), rows=rows)
    say(console, *sheet_lines(sheet, room(console)))
    for setting in dict.fromkeys(one.setting for one in trials):
        first = next(one for one in trials if one.setting == setting)
        for verb in first.verbs:
            say(console, f"{setting}: {' '.join(words_of(first, verb))}")
    seconds = [known[one.setting].seconds for one in left]
    total = sum(one for one in seconds if one is not None) / max(1, min(workers, len(left)))
    lower = any(one.seconds is None or not one.whole for one in known.values())
    least = "at least " if lower else "about "
    said = f"{len(left)} to run, {workers} at a time: {least}{clock(math.ceil(total))}"
    say(console, said)
    if lower:
        say(console, "(training only; the rest is known once one trial of a setting is finished)")


def _told(trial: Trial, finished: set[str], known: dict[str, Forecast]) -> str:
    if trial.name in finished:
        return "finished"
    seconds = known[trial.setting].seconds
    return "unknown" if seconds is None else clock(seconds)


def _forecast(setting: str, left: Sequence[Trial], done: Sequence[TrialResult]) -> Forecast:
    """From finished trials of the setting; else from the first seconds of one."""
    seconds = [
        one.seconds for one in done if one.trial.setting == setting and one.seconds is not None
    ]
    if seconds:
        return Forecast(seconds=statistics.fmean(seconds), whole=True)
    first = next(one for one in left if one.setting == setting)
    with tempfile.TemporaryDirectory() as folder:
        found = _watched(replace(first, folder=Path(folder) / "probe"))
    return Forecast(seconds=found, whole=[*first.verbs] == ["train"])


def _watched(trial: Trial) -> float | None:
    """Begin a training in a process of its own, and ask its log what is left; then end it.

    Raises:
        TrainingError: it failed.
    """
    begun, first = time.monotonic(), None
    told = trial.folder.with_name("told.txt")
    with told.open("wb") as file:
        process = subprocess.Popen(
            process_words(trial, "train"), stdin=subprocess.DEVNULL, stdout=file, stderr=file
        )
    try:
        while process.poll() is None:
            step = _last_step(trial.folder / RUN / LOG_FILE)
            now = time.monotonic()
            first = first or (now if step is not None else None)
            if step is not None and first is not None and now - first > _WATCH:
                return now - begun + step["seconds_left"]
            if step is None and now - begun > _PATIENCE:
                return None
            time.sleep(0.2)
        if process.returncode != 0:
            why = reason_in(told.read_text(encoding="utf-8", errors="replace").splitlines())
            raise TrainingError(f"plan: setting {trial.setting!r}, train fails at once: {why}")
        return time.monotonic() - begun
    finally:
        process.terminate()
        process.wait()


def _last_step(log: Path) -> dict[str, Any] | None:
    """The last report of a step that says how much time is left."""
    if not log.is_file():
        return None
    # The last line may be half written.
    lines = log.read_text(encoding="utf-8").split("\n")[:-1]
    steps = [one for one in map(json.loads, lines) if one["event"] == "step"]
    return next((one for one in reversed(steps) if one["seconds_left"] is not None), None)

"""One trial of a sweep: its folder, its record, and an attempt to bring it to its end."""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pcore.errors import InputError, PcoreError
from pcore.evaluation.tables import jsonable, write_json
from pcore.files.run_record import relative
from pcore.sweep.sweep_plan import SweepPlan, VerbName
from pcore.sweep.sweep_storage import fetch, mirrored

TRIALS = "trials"
RECORD_FILE, OUTPUT_FILE, INPUTS_FILE = "trial.json", "output.txt", "inputs.json"
SCENE = "scene"
"""How names of a trial's inputs begin that are of its scene."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One scene with one setting and one seed.

    Attributes:
        scene: its name in the plan.
        setting: the setting's name.
        seed: of every training in it.
        scene_folder: where the scene lies, absolute.
        folder: for everything the trial writes, absolute.
        verbs: what is run, in this order, each with its options as on the command line.
        threads: of the CPU, of each process.
        device: to compute on.
        processes: that share its work.
        storage: URL that the folder is mirrored to, for machines that share no disk; None: none.
        inputs: hashes of the files that it reads, by name.
    """

    scene: str
    setting: str
    seed: int
    scene_folder: Path
    folder: Path
    verbs: Mapping[VerbName, Mapping[str, Any]]
    threads: int
    device: str
    processes: int = 1
    storage: str | None = None
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.scene}/{self.setting}/seed-{self.seed}"

    @property
    def stamp(self) -> Any:
        """All that its results depend on, as JSON values."""
        scene = relative(self.scene_folder, self.folder)
        verbs = [[name, dict(options)] for name, options in self.verbs.items()]
        shared = [self.processes] if self.processes > 1 else []
        return [scene, verbs, self.seed, self.threads, self.device, *shared]


Runner = Callable[[Trial], None]
"""Runs all verbs of a trial, going on from whatever lies in its folder."""


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """How an attempt at a trial ended.

    Attributes:
        trial: which.
        failed: why it did not come to its end; None where it did.
        seconds: on the clock, if no earlier attempt did a part of the work; else None.
    """

    trial: Trial
    failed: str | None = None
    seconds: float | None = None


def trials_of(
    plan: SweepPlan, *, beside: Path, folder: Path, storage: str | None = None
) -> list[Trial]:
    """List all trials: scenes, settings, seeds from slow to fast.

    Args:
        plan: what to do.
        beside: folder that the plan's paths are seen from.
        folder: of the sweep.
        storage: URL of the sweep's storage.
    """
    return [
        Trial(
            scene=scene,
            setting=setting,
            seed=seed,
            scene_folder=(beside / place).resolve(),
            folder=folder.resolve() / TRIALS / scene / setting / f"seed-{seed}",
            verbs=given.verbs(),
            threads=plan.resources.cpus,
            device="cuda" if plan.resources.gpus > 0 else "cpu",
            processes=plan.resources.processes,
            storage=None
            if storage is None
            else f"{storage.rstrip('/')}/{TRIALS}/{scene}/{setting}/seed-{seed}",
        )
        for scene, place in plan.scenes.items()
        for setting, given in plan.settings.items()
        for seed in plan.seeds
    ]


def finished_trial(trial: Trial, place: Path | None = None) -> TrialResult | None:
    """What is on record of a trial that came to its end as it stands in the plan; else None.

    Args:
        trial: which.
        place: folder of its records; default: its own.
    """
    try:
        record: dict[str, Any] = json.loads(((place or trial.folder) / RECORD_FILE).read_bytes())
        if record["stamp"] != jsonable(trial.stamp) or record["failed"] is not None:
            return None
        return TrialResult(trial=trial, seconds=record["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def check_inputs(trial: Trial, place: Path | None = None) -> None:
    """Refuse to go on with a trial that began with other files: half of it would be of old ones.

    Args:
        trial: which; its records are there.
        place: folder of its records; default: its own.

    Raises:
        InputError: a file has changed, come or gone.
    """
    try:
        before: Any = json.loads(((place or trial.folder) / INPUTS_FILE).read_bytes())
    except (OSError, ValueError):
        return  # Not begun, or stopped at once.
    if _failed_at_once(place or trial.folder):
        return  # What it failed of may have been mended, and nothing of the old files is kept.
    now = trial.inputs
    # Another name of an option's file is another setting, which is run again.
    differ = sorted(
        name
        for name in {*before, *now}
        if before.get(name) != now.get(name)
        and (name.startswith(SCENE) or (name in before and name in now))
    )
    if differ:
        more = f" and {len(differ) - 1} more" if len(differ) > 1 else ""
        raise InputError(
            f"plan: trial {trial.name}: expected the files that it began with, got others: "
            f"{differ[0]}{more}; give what has changed another name in the plan, or the sweep "
            "another folder (and storage)"
        )


def _failed_at_once(place: Path) -> bool:
    try:
        failed = json.loads((place / RECORD_FILE).read_bytes())["failed"] is not None
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return failed and not any(True for one in ("*.safetensors", "*.pt") for _ in place.rglob(one))


def fetch_records(trial: Trial, place: Path | None = None) -> None:
    """Bring tables and records of a trial from its storage, where it has one.

    Args:
        trial: which.
        place: folder that they go to; default: its own.

    Raises:
        OSError: the storage cannot be read.
    """
    if trial.storage is not None:
        fetch(trial.storage, place or trial.folder, records=True)


def attempt(trial: Trial, run: Runner) -> TrialResult:
    """Run a trial, with what it prints in a file of its folder, and write how it ended.

    A trial that fails must not cost the others: every error becomes a result.

    Raises:
        KeyboardInterrupt: Ctrl-C; trainings have saved their state.
    """
    try:
        with mirrored(trial.folder, trial.storage):
            return _attempt(trial, run)
    except OSError as error:
        told = str(error) if error.strerror is None else f"{trial.folder}: {error.strerror}"
        return TrialResult(trial=trial, failed=told)


def _attempt(trial: Trial, run: Runner) -> TrialResult:
    begun, fresh = time.monotonic(), not trial.folder.exists()
    trial.folder.mkdir(parents=True, exist_ok=True)
    write_json(trial.folder / INPUTS_FILE, dict(trial.inputs))
    path = trial.folder / OUTPUT_FILE
    with path.open("a", encoding="utf-8", buffering=1) as file:
        failed = _failure(trial, run, file)
    result = TrialResult(
        trial=trial,
        failed=failed,
        seconds=time.monotonic() - begun if fresh and failed is None else None,
    )
    record = {"stamp": trial.stamp, "failed": failed, "seconds": result.seconds}
    write_json(trial.folder / RECORD_FILE, record)
    return result


def _failure(trial: Trial, run: Runner, file: Any) -> str | None:
    """Run it and say why it failed; None when it did not."""
    with redirect_stdout(file), redirect_stderr(file):
        try:
            run(trial)
        except PcoreError as error:
            file.write(f"{error}\n")
            return str(error)
        except Exception as error:
            # Of packages that are not ours, or a mistake of ours: the file has the whole story.
            file.write(traceback.format_exc())
            return f"{type(error).__name__}: {error}"
    return None

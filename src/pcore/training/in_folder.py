"""A training in a run folder: logs, resuming, and nothing left behind when it cannot begin."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch

from pcore.errors import DependencyError, PcoreError
from pcore.files.lock import LOCK_FILE
from pcore.files.manifest import MANIFEST_FILE, new_manifest, same_run
from pcore.files.provenance import Stage, made_by
from pcore.files.run_folder import RunFolder
from pcore.files.run_place import bytes_needed, saved_nothing
from pcore.files.run_record import SPENT, finished, relative
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig
from pcore.training.events import JsonLinesLog, Listener, TensorBoardLog, fan_out

Result = TypeVar("Result")


def _ignore(text: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, kw_only=True)
class FolderPlan:
    """What a training in a folder is, beside the training itself.

    Attributes:
        path: the run folder.
        stage: what runs.
        scene: folder of the scene, recorded as seen from the run; or its name.
        config: all that decides the result, as JSON values.
        device: what computes, for the record.
        resume: go on with the run that is there.
        tensorboard: write TensorBoard's files too, where its package is installed.
        needed: bytes that will be written.
        note: told in a sentence where it goes on from, and what had to be left out.
    """

    path: Path
    stage: Stage
    scene: Path | str
    config: Mapping[str, Any]
    device: str = "cpu"
    resume: bool = False
    tensorboard: bool = False
    needed: int = 0
    note: Callable[[str], None] = _ignore


def train_in_folder(
    plan: FolderPlan, train: Callable[[RunFolder, Listener], Result], listener: Listener
) -> Result | None:
    """Train in a folder and log all events there; a finished run is left as it is.

    Args:
        plan: which folder, and what is written down about the run.
        train: trains in the folder that it is given and tells the listener that it is given.
        listener: told of all events, besides the logs.

    Returns:
        What was trained; None where the run was finished already.

    Raises:
        InputError: the folder is in use, holds another run, or nothing to resume.
        PcoreError: whatever the training raises; a run that saved nothing then leaves no trace.
        KeyboardInterrupt: Ctrl-C; the same holds before the first save.
    """
    scene = plan.scene if isinstance(plan.scene, str) else relative(plan.scene, plan.path)
    if plan.resume and finished(plan.path):
        same_run(plan.path, new_manifest(plan.stage, scene, plan.config))
        plan.note("finished already; nothing is left to do")
        return None
    made = not plan.path.exists()
    with RunFolder.create(
        plan.path,
        stage=plan.stage,
        scene=scene,
        config=plan.config,
        resume=plan.resume,
        needed=plan.needed,
    ) as run:
        try:
            return _train(plan, run, train, listener)
        except (PcoreError, KeyboardInterrupt):
            if saved_nothing(plan.path):
                _remove_traces(run, whole=made)
            raise


def _train(
    plan: FolderPlan,
    run: RunFolder,
    train: Callable[[RunFolder, Listener], Result],
    listener: Listener,
) -> Result:
    step = run.saved_step()
    resumed = None if step is None else (plan.stage, step)
    if plan.resume:
        plan.note("begins anew" if step is None else f"goes on from step {step:,}")
    began = {"step": step or 0, **made_by(plan.device)}
    run.update(made_by=[*(run.notes.get("made_by") or []), began])
    with ExitStack() as stack:
        stack.enter_context(_spending(run, 0.0 if step is None else run.notes.get(SPENT)))
        listeners: list[Listener] = [stack.enter_context(JsonLinesLog(run.log, resumed=resumed))]
        if plan.tensorboard:
            try:
                board = TensorBoardLog(run.tensorboard, resumed=resumed)
                listeners.append(stack.enter_context(board))
            except DependencyError as error:
                plan.note(f"note: {error}")
        return train(run, fan_out(*listeners, listener))


@contextmanager
def _spending(run: RunFolder, before: float | None) -> Generator[None]:
    """Note processor seconds of a training, and those before; None where they are not known."""
    # Of a training that is killed nobody knows what it took, and so of one that goes on from there.
    run.update(**{SPENT: None})
    begin = time.process_time()
    try:
        yield
    finally:
        if before is not None:
            run.update(**{SPENT: round(before + time.process_time() - begin, 3)})


def _remove_traces(run: RunFolder, *, whole: bool) -> None:
    """Delete what a training that saved nothing wrote; with `whole` the folder that it made too."""
    for file in (run.path / MANIFEST_FILE, run.log):
        file.unlink(missing_ok=True)
    shutil.rmtree(run.tensorboard, ignore_errors=True)
    if whole:
        # Nobody else can hold the lock of a folder that goes away with it.
        run.close()
        (run.path / LOCK_FILE).unlink(missing_ok=True)
        with suppress(OSError):  # Somebody put a file there: the folder stays.
            run.path.rmdir()


def disk_space(model: PaprConfig, points: int) -> int:
    """Bytes that a run of these networks with at most so many points will need."""
    with torch.device("meta"):
        networks = sum(parameter.numel() for parameter in Papr(model).parameters())
    return bytes_needed(networks + points * (4 + model.feature_size))

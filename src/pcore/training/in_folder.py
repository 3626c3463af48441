"""A training in a run folder: logs, resuming, and nothing left behind when it cannot begin."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch

from pcore.errors import DependencyError, PcoreError
from pcore.files.lock import LOCK_FILE
from pcore.files.manifest import MANIFEST_FILE, new_manifest, same_run
from pcore.files.provenance import Stage, made_by
from pcore.files.run_folder import RunFolder
from pcore.files.run_place import bytes_needed, saved_nothing
from pcore.files.run_record import SPENT, RunRecord, finished, relative
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig
from pcore.training.events import JsonLinesLog, Listener, TensorBoardLog, fan_out

Result = TypeVar("Result")


def _tell_nobody(text: str) -> None:
    """Say nothing."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What a training does besides learning.

    Attributes:
        light: estimate the light of the photos at the end; where that is not possible the object
            has none, and `note` is told why.
        resume: go on exactly where the run in the folder was interrupted.
        tensorboard: write curves for TensorBoard into the folder, where its package is installed.
        compiled: use torch.compile where it pays, on a GPU.
        preset: what the settings are called in the record; None finds their name.
        note: told in a sentence where it goes on from, and what had to be left out.
    """

    light: bool = True
    resume: bool = False
    tensorboard: bool = False
    compiled: bool = True
    preset: str | None = None
    note: Callable[[str], None] = _tell_nobody


def train_in_folder(
    record: RunRecord,
    train: Callable[[RunFolder, Listener], Result],
    listener: Listener,
    options: RunOptions,
    *,
    scene: Path | str,
    device: str = "cpu",
    needed: int = 0,
) -> Result | None:
    """Train in a folder and log all events there; a finished run is left as it is.

    Args:
        record: which folder, and what is written down about the run.
        train: trains in the folder that it is given and tells the listener that it is given.
        listener: told of all events, besides the logs.
        options: resuming, logs.
        scene: folder of the scene, recorded as seen from the run; or its name.
        device: what computes, for the record.
        needed: bytes that will be written.

    Returns:
        What was trained; None where the run was finished already.

    Raises:
        InputError: the folder is in use, holds another run, or nothing to resume.
        PcoreError: whatever the training raises; a run that saved nothing then leaves no trace.
        KeyboardInterrupt: Ctrl-C; the same holds before the first save.
    """
    path, stage, config = record.path, record.stage, record.config
    assert path is not None, "the caller tells folders from memory"
    scene = scene if isinstance(scene, str) else relative(scene, path)
    if options.resume and finished(path):
        same_run(path, new_manifest(stage, scene, config))
        options.note("finished already; nothing is left to do")
        return None
    made = not path.exists()
    with RunFolder.create(
        path, stage=stage, scene=scene, config=config, resume=options.resume, needed=needed
    ) as run:
        try:
            with _logged(run, stage, options, device) as logs:
                return train(run, fan_out(*logs, listener))
        except (PcoreError, KeyboardInterrupt):
            if saved_nothing(path):
                _remove_traces(run, whole=made)
            raise


@contextmanager
def _logged(
    run: RunFolder, stage: Stage, options: RunOptions, device: str
) -> Generator[list[Listener]]:
    """Write down that a training begins, and what it takes; gives the logs of the folder."""
    step = run.saved_step()
    resumed = None if step is None else (stage, step)
    if options.resume:
        options.note("begins anew" if step is None else f"goes on from step {step:,}")
    began = {"step": step or 0, **made_by(device)}
    run.update(made_by=[*(run.notes.get("made_by") or []), began])
    with ExitStack() as stack:
        stack.enter_context(_spending(run, 0.0 if step is None else run.notes.get(SPENT)))
        logs: list[Listener] = [stack.enter_context(JsonLinesLog(run.log, resumed=resumed))]
        if options.tensorboard:
            try:
                board = TensorBoardLog(run.tensorboard, resumed=resumed)
                logs.append(stack.enter_context(board))
            except DependencyError as error:
                options.note(f"note: {error}")
        yield logs


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

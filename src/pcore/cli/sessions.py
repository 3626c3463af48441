"""A training in a run folder: logs, bar, resuming, and nothing left behind when it cannot begin."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from pcore.errors import DependencyError, PcoreError

if TYPE_CHECKING:
    from pcore.files.provenance import Stage
    from pcore.files.run_folder import RunFolder
    from pcore.model.papr_config import PaprConfig
    from pcore.training.events import Listener

Train = Callable[["RunFolder", "Listener"], object]


@dataclass(frozen=True, kw_only=True)
class Session:
    """What a training in a folder is, beside the training itself.

    Attributes:
        path: the run folder.
        stage: what runs.
        scene: folder of the scene; recorded as seen from the run.
        config: all that decides the result, as JSON values.
        resume: go on with the run that is there.
        tensorboard: write TensorBoard's files too.
        needed: bytes that will be written.
    """

    path: Path
    stage: Stage
    scene: Path
    config: Mapping[str, Any]
    resume: bool
    tensorboard: bool
    needed: int


def run_session(session: Session, train: Train, console: Console) -> bool:
    """Train in the folder of the session, showing and logging all events.

    A run that is to be resumed and was finished already is left as it is.

    Returns:
        Whether anything was trained.

    Raises:
        InputError: the folder is in use, holds another run, or nothing to resume.
        PcoreError: whatever the training raises; a run that saved nothing then leaves no trace.
    """
    from pcore.cli.stages import finished, relative
    from pcore.files.manifest import new_manifest, same_run
    from pcore.files.run_folder import RunFolder

    where = relative(session.scene, session.path)
    if session.resume and finished(session.path):
        same_run(session.path, new_manifest(session.stage, where, session.config))
        console.print("finished already; nothing is left to do")
        return False
    made = not session.path.exists()
    fresh = made or (session.path.is_dir() and not any(session.path.iterdir()))
    with RunFolder.create(
        session.path,
        stage=session.stage,
        scene=where,
        config=session.config,
        resume=session.resume,
        needed=session.needed,
    ) as run:
        try:
            _train(session, run, train, console)
        except PcoreError:
            if fresh and not run.state.exists() and not run.model.exists():
                _remove_traces(run, whole=made)
            raise
    return True


def _train(session: Session, run: RunFolder, train: Train, console: Console) -> None:
    from pcore.cli.console import ProgressDisplay
    from pcore.training.events import JsonLinesLog, TensorBoardLog, fan_out

    step = run.saved_step()
    resumed = None if step is None else (session.stage, step)
    if session.resume:
        console.print(Text("begins anew" if step is None else f"goes on from step {step:,}"))
    with ExitStack() as stack:
        listeners: list[Listener] = [stack.enter_context(JsonLinesLog(run.log, resumed=resumed))]
        if session.tensorboard:
            try:
                board = TensorBoardLog(run.tensorboard, resumed=resumed)
                listeners.append(stack.enter_context(board))
            except DependencyError as error:
                console.print(Text(f"note: {error}"), soft_wrap=True)
        listeners.append(stack.enter_context(ProgressDisplay(console)))
        train(run, fan_out(*listeners))


def _remove_traces(run: RunFolder, *, whole: bool) -> None:
    """Delete what a training that saved nothing wrote; with `whole` the folder that it made too."""
    from pcore.files.lock import LOCK_FILE
    from pcore.files.manifest import MANIFEST_FILE

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
    import torch

    from pcore.files.run_folder import bytes_needed
    from pcore.model.papr import Papr

    with torch.device("meta"):
        networks = sum(parameter.numel() for parameter in Papr(model).parameters())
    return bytes_needed(networks + points * (4 + model.feature_size))


def show_result(console: Console, path: Path, *, next_command: str) -> None:
    """Say how good a run became, where it is, and what can be done with it."""
    from pcore.files.run_folder import RunFolder

    validation = RunFolder.open(path).notes.get("validation") or {}
    psnr = validation.get("kept_psnr" if "kept_step" in validation else "psnr")
    quality = "" if psnr is None else f": {psnr:.2f} dB on held-out training views"
    console.print(Text(f"{path}{quality}"), soft_wrap=True)
    console.print(Text(f"next: {next_command}"), soft_wrap=True)

"""Trainings as parts of a longer story: made once, continued when they were interrupted."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pcore.model.provenance import Stage
from pcore.training.events import JsonLinesLog, Listener, fan_out
from pcore.training.manifest import MANIFEST_FILE, new_manifest, same_run
from pcore.training.output import RunFolder
from pcore.training.trained import Trained

Train = Callable[[RunFolder, Listener], Trained]


def finished(path: Path) -> bool:
    """Whether a run folder holds a training that came to its end."""
    if not (path / MANIFEST_FILE).is_file():
        return False
    run = RunFolder.open(path)
    return run.notes.get("status") == "finished" and run.model.is_file()


def run_stage(
    path: Path,
    train: Train,
    *,
    stage: str,
    scene: Path,
    config: Mapping[str, Any],
    listener: Listener,
) -> None:
    """Train into a run folder, go on where it stopped, or do nothing when it is finished.

    Args:
        path: the run folder.
        train: does it, given the folder and a listener.
        stage: "pretrain" or "finetune".
        scene: folder of the scene; recorded relative to the run, so that both can move together.
        config: all that decides the result, as JSON values.
        listener: told of the progress; everything also goes into `log.jsonl`.

    Raises:
        InputError: the folder holds a run of other settings.
        TrainingError: training diverged or cannot write.
    """
    kind: Stage = "pretrain" if stage == "pretrain" else "finetune"
    where = relative(scene, path)
    if finished(path):
        same_run(path, new_manifest(kind, where, config))
        return
    known = (path / MANIFEST_FILE).is_file()
    with RunFolder.create(path, stage=kind, scene=where, config=config, resume=known) as run:
        step = run.saved_step()
        with JsonLinesLog(run.log, resumed=None if step is None else (stage, step)) as log:
            train(run, fan_out(log, listener))


def relative(target: Path, start: Path) -> str:
    """Path of `target` as seen from the folder `start`, with forward slashes."""
    try:
        return Path(os.path.relpath(target.resolve(), start.resolve())).as_posix()
    except ValueError:  # Another drive of Windows.
        return str(target.resolve())

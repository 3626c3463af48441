"""Runs as parts of a longer story: whether they are done, and how they name each other."""

from __future__ import annotations

import os
from pathlib import Path

from pcore.files.manifest import MANIFEST_FILE
from pcore.files.run_folder import RunFolder


def begun(path: Path) -> bool:
    """Whether a folder holds a run, finished or not."""
    return (path / MANIFEST_FILE).is_file()


def finished(path: Path) -> bool:
    """Whether a folder holds a training that came to its end."""
    if not begun(path):
        return False
    run = RunFolder.open(path)
    return run.notes.get("status") == "finished" and run.has_model


def relative(target: Path, start: Path) -> str:
    """Path of `target` as seen from the folder `start`, with forward slashes."""
    try:
        return Path(os.path.relpath(target.resolve(), start.resolve())).as_posix()
    except ValueError:  # Another drive of Windows.
        return str(target.resolve())

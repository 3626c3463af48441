"""Where a run may be written: what a folder holds already, and whether there is space."""

from __future__ import annotations

import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from pcore.errors import InputError, TrainingError
from pcore.files.atomic import PARTIAL_SUFFIX, remove_partials, write_atomically
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.files.lock import LOCK_FILE
from pcore.files.manifest import MANIFEST_FILE, read_manifest
from pcore.files.model_file import MODEL_FILE
from pcore.files.training_state import STATE_FILE
from pcore.validation import first_names

MASKS = "masks"
"""Folder of the masks that were made for a run."""
RUNNING = "running"
"""Status of a run that has not ended, or whose process was killed."""
_BYTES_PER_NUMBER = 4


def bytes_needed(numbers: int) -> int:
    """Estimate the disk space of a run in bytes.

    Args:
        numbers: parameters of the networks and of the largest cloud together.

    Counted are weights, two moments of Adam, a running average and the best weights in the state,
    and the model file; all twice, because the old files stay until the new ones are complete;
    and 16 MB for logs.
    """
    state, model = 5 * numbers, numbers
    return 2 * (state + model) * _BYTES_PER_NUMBER + 16_000_000


def check_place(path: Path, *, resume: bool) -> None:
    """Raise InputError when `path` holds what must not be overwritten; write nothing."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file: expected a folder for the run; use another -o")
    if not path.exists():
        if resume:
            raise InputError(
                f"nothing to resume at {path}: expected the folder of an interrupted run; check "
                "the path, or leave out --resume to start one"
            )
        return
    if (path / MANIFEST_FILE).exists():
        if resume or saved_nothing(path):
            return
        raise InputError(
            f"{path} holds a run already, which is not overwritten: continue it with --resume, "
            "or choose another folder with -o"
        )
    foreign = first_names(item.name for item in path.iterdir() if not _is_leftover(item))
    if foreign:
        raise InputError(
            f"{path} holds other files ({foreign}): "
            "expected a new or empty folder for the run; choose another one with -o"
        )


def saved_nothing(path: Path) -> bool:
    """Whether the run in a folder ended before its first save, so that it can begin anew."""
    saved = (STATE_FILE, MODEL_FILE, GAUSSIANS_FILE)
    if not (path / MANIFEST_FILE).is_file() or any((path / name).exists() for name in saved):
        return False
    return read_manifest(path)["notes"].get("status") == RUNNING


def _is_leftover(item: Path) -> bool:
    """Whether it stands before a run: masks made for it, or what a killed process left behind."""
    return item.name == MASKS or item.name == LOCK_FILE or item.name.endswith(PARTIAL_SUFFIX)


def check_space(path: Path, needed: int) -> None:
    """Raise TrainingError where the disk has fewer bytes than a run needs."""
    parent = next(one for one in (path.absolute(), *path.absolute().parents) if one.exists())
    free = shutil.disk_usage(parent).free
    if free < needed:
        raise TrainingError(
            f"not enough space for the run at {path}: expected {needed / 1e6:.0f} MB free, got "
            f"{free / 1e6:.0f} MB; free some or choose a folder on another disk with -o"
        )


@contextmanager
def unwritable(path: Path) -> Generator[None]:
    """Turn a failure to write into a folder into a TrainingError."""
    try:
        yield
    except OSError as error:
        raise TrainingError(
            f"cannot write into {path}: {error.strerror or error}; expected a writable folder, "
            "choose another one with -o"
        ) from error


def probe(path: Path) -> None:
    """Write and delete a small file: permissions alone do not tell about read-only mounts."""
    write_atomically(path / f".probe{PARTIAL_SUFFIX}", os.urandom(4096))
    remove_partials(path)

"""Folders that results go into: new, empty or ours, never taken from something else."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from pcore.errors import InputError


def pictures_folder(folder: Path, *, overwrite: bool | None) -> None:
    """Make a folder for pictures; refuse one that holds other files.

    Args:
        folder: made with its parents.
        overwrite: accept what is there; files of the same names are replaced, others stay. None:
            False, and the command has no such option.
    """
    there = _content(folder, "pictures")
    if there and not overwrite:
        way_out = "" if overwrite is None else ", or --overwrite to replace those of the same name"
        raise InputError(
            f"{folder} holds files already ({there}), which are not overwritten: use another "
            f"-o{way_out}"
        )
    folder.mkdir(parents=True, exist_ok=True)


def check_place(folder: Path) -> None:
    """Refuse a place at which no folder can be made, before any work; leaves nothing there."""
    there = next(one for one in (folder, *folder.absolute().parents) if one.exists())
    if not there.is_dir():
        raise InputError(f"{folder}: {there} is a file: expected a folder; choose another place")
    try:
        with tempfile.TemporaryDirectory(prefix=".pcore-", dir=there):
            pass
    except OSError as error:
        raise InputError(
            f"{folder}: nothing can be written into {there} ({error.strerror}); choose another "
            "place"
        ) from error


def results_folder(folder: Path, file: str, *, about: Path) -> None:
    """Make a folder for results and write into it which run or scene they are about.

    Results of the same run are replaced, also those of an evaluation that did not come to its end.

    Args:
        folder: where the results go; made with its parents.
        file: name of their summary.
        about: the run, or the scene, that they are about.
    """
    from pcore.evaluation.tables import write_json
    from pcore.files.run_record import relative

    there, path = _content(folder, "results"), folder / file
    if path.exists():
        subject = _subject(path)
        if subject != str(about.resolve()):
            raise InputError(
                f"{folder} holds the results of {subject or 'something else'}, which are not "
                f"overwritten by those of {about}; use another -o"
            )
        return
    if there:
        raise InputError(
            f"{folder} holds other files ({there}): expected a new or empty folder for results, or "
            f"one with results of {about}; use another -o"
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_json(path, {"about": {"run": relative(about, folder)}, "status": "not finished"})


def _content(folder: Path, kind: str) -> str:
    """First names in a folder, empty when there are none; InputError for a file or a run."""
    from pcore.files.manifest import MANIFEST_FILE
    from pcore.validation import first_names

    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file: expected a folder for {kind}; use another -o")
    if (folder / MANIFEST_FILE).exists():
        raise InputError(
            f"{folder} holds a run: expected a folder for {kind} only; use another -o, or none "
            "for one inside the run"
        )
    if folder.exists():
        return first_names(item.name for item in folder.iterdir())
    check_place(folder)
    return ""


def _subject(path: Path) -> str | None:
    """Run that a summary is about; None when it is no summary of ours."""
    try:
        record: Any = json.loads(path.read_text(encoding="utf-8"))
        # As seen from the results, so that both can move together.
        return str((path.parent / record["about"]["run"]).resolve())
    except (OSError, ValueError, KeyError, TypeError):
        return None

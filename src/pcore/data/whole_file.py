"""Files that are there whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcore.errors import InputError

PARTIAL_SUFFIX = ".partial"
"""Ending of files that are being written; one that is left over comes from a killed process."""


def replace_file(path: Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it; OSError leaves an old one untouched."""
    with replacing(path) as partial:
        partial.write_bytes(content)


@contextmanager
def replacing(path: Path) -> Generator[Path]:
    """Give a hidden file beside `path` to write, which takes its place when all went well.

    An OSError, of a full disk for instance, is one of `path` then, which people know.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL_SUFFIX}")
    try:
        yield partial
        partial.replace(path)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (None, str(partial)):
            error.filename = str(path)
        raise


def write_whole(path: Path, content: bytes, what: str) -> None:
    """Write a file as `replace_file` does, for verbs that say what they write.

    Args:
        path: where to; the folder must exist.
        content: all of it.
        what: for the message, what it holds.

    Raises:
        InputError: a place that cannot be written to.
    """
    if not path.parent.is_dir():
        raise InputError(f"{path}: expected an existing folder to write to, got {path.parent}")
    try:
        replace_file(path, content)
    except OSError as error:
        raise InputError(
            f"{path}: cannot write the {what} ({error.strerror}); expected a place that can be "
            "written to"
        ) from error


def save_json(path: Path, content: Mapping[str, Any], what: str) -> None:
    """Write JSON values as `write_whole` does; raises InputError."""
    write_whole(path, (json.dumps(content, indent=1) + "\n").encode(), what)

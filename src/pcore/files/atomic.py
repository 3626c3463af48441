"""Writing files so that a reader, or a crash, only ever sees the old or the new content."""

from __future__ import annotations

import os
from pathlib import Path

from pcore.data.whole_file import PARTIAL_SUFFIX, replacing


def write_atomically(path: Path, content: bytes | memoryview) -> None:
    """Replace the content of `path`: whoever looks finds all of the old or all of the new bytes.

    The bytes go to a hidden file of the same folder (renaming is atomic within one file system
    only) and reach the disk before the name does; otherwise a power cut could leave the new name
    with no content.

    Raises:
        OSError: the disk is full, read-only or gone; `path` is then as it was before.
    """
    with replacing(path) as partial, partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    _sync_folder(path.parent)


def remove_partials(folder: Path) -> None:
    """Delete what killed writers left in `folder`; only for who holds the folder's lock."""
    for partial in folder.glob(f".*{PARTIAL_SUFFIX}"):
        partial.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make a rename durable; without effect where folders cannot be opened (Windows)."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

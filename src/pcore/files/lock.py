"""A lock on a folder, held as long as the process lives."""

from __future__ import annotations

import os
import sys
from io import FileIO
from pathlib import Path

from pcore.errors import InputError

LOCK_FILE = ".lock"


class FolderLock:
    """An advisory lock of the operating system, so that a killed process cannot leave it behind.

    The file stays when the lock is released: deleting it would let two processes lock two files
    of one name.
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file

    @classmethod
    def acquire(cls, folder: Path) -> FolderLock:
        """Lock a folder.

        Raises:
            InputError: another process holds it; the message names its id.
            OSError: the folder is not writable.
        """
        path = folder / LOCK_FILE
        file = FileIO(os.open(path, os.O_RDWR | os.O_CREAT, 0o644), "r+")
        try:
            _lock(file.fileno())
        except (BlockingIOError, PermissionError) as error:
            owner = file.read(64).decode(errors="replace").strip() or "unknown"
            file.close()
            raise InputError(
                f"another process (id {owner}) is training into {folder}: expected one process "
                "per run; wait for it, stop it, or choose another folder with -o"
            ) from error
        file.truncate(0)
        file.write(f"{os.getpid()}\n".encode())
        return cls(file)

    def release(self) -> None:
        """Let others lock the folder."""
        if not self._file.closed:
            self._file.truncate(0)
            self._file.close()


def held(folder: Path) -> bool:
    """Whether a living process holds the lock of a folder."""
    if not (folder / LOCK_FILE).is_file():
        return False
    try:
        with (folder / LOCK_FILE).open("rb") as file:
            # Whoever gets the lock was alone; it goes as soon as the file is closed.
            _lock(file.fileno())
    except OSError:
        return True
    return False


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        # One byte far behind the content, which others must be able to read.
        os.lseek(descriptor, 1 << 20, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

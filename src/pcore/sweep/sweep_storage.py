"""A place for trials that all machines reach though they share no disk: any URL of fsspec.

A trial is run in a folder of its machine and mirrored: what the storage has of it is fetched before
an attempt, what changes is sent along while it runs, and all of it at its end, its record last.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from pcore.errors import DependencyError, InputError, StorageError
from pcore.files.lock import LOCK_FILE
from pcore.files.run_place import bytes_needed, check_space

SEND_EVERY = 15.0
"""Seconds between looks at what has changed; a killed worker loses no more than that."""
_RECORDS = (".json", ".csv", ".txt")
_LAST = "trial.json"
_PROBE, _PART = ".pcore-storage", ".part"


def check_storage(url: str) -> None:
    """Refuse a place that cannot be written.

    Raises:
        DependencyError: its package is missing.
        InputError: no such kind of storage, or it cannot be written.
        TrainingError: a disk that has no space for any run.
    """
    try:
        files, root = opened(url)
        bucket = root.partition("/")[0]  # Empty where paths begin with /, as on disks.
        if bucket and not files.exists(bucket):
            raise FileNotFoundError(f"there is no bucket {bucket!r}")  # Nor is one made.
        files.makedirs(root, exist_ok=True)
        files.pipe_file(f"{root}/{_PROBE}", b"pcore")
        files.rm_file(f"{root}/{_PROBE}")
    except ImportError as error:
        raise DependencyError(
            f"--storage {url}: needs a package that is missing ({error}); s3:// needs s3fs, gs:// "
            "gcsfs, abfs:// adlfs"
        ) from error
    except Exception as error:  # Every kind of storage has its own.
        raise InputError(
            f"--storage {url}: expected a place that can be written, got: {error}; see fsspec's "
            "documentation for the forms of URLs"
        ) from error
    if "file" in files.protocol:
        check_space(Path(root), bytes_needed(0))


def fetch(url: str, folder: Path, *, records: bool = False) -> bool:
    """Bring files of the storage into a folder, over those of the same names.

    Args:
        url: of the folder in the storage.
        folder: where they go.
        records: only tables and records: no weights, no states of trainings.

    Returns:
        Whether there were any.

    Raises:
        OSError: the storage cannot be read.
    """
    with storage_errors(url):
        files, root = opened(url)
        found = _names(files, root)
        for name in found:
            if not records or name.endswith(_RECORDS):
                path = folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                part = path.with_name(f".{path.name}{_PART}")
                files.get_file(f"{root}/{name}", str(part))
                part.replace(path)
    return bool(found)


@contextmanager
def mirrored(folder: Path, url: str | None) -> Generator[None]:
    """Do something in a folder that begins and ends as the storage's; without a URL just do it.

    Raises:
        OSError: the storage cannot be read or written.
    """
    if url is None:
        yield
        return
    with storage_errors(url):
        begun = bool(_names(*opened(url)))
    if begun:
        # The storage is right: what lies here may be of an attempt before the last.
        shutil.rmtree(folder, ignore_errors=True)
        fetch(url, folder)
    sender = _Sender(folder, url, fetched=begun)
    sender.start()
    try:
        yield
    finally:
        sender.stop()


def publish(folder: Path, url: str, names: Iterable[str]) -> None:
    """Send some files of a folder.

    Raises:
        OSError: the storage cannot be written.
    """
    with storage_errors(url):
        files, root = opened(url)
        for name in names:
            _send(files, root, folder, name)


class _Sender:
    """Sends what changes in a folder, now and then and at the end."""

    def __init__(self, folder: Path, url: str, *, fetched: bool) -> None:
        self._folder, self._url = folder, url
        # What an attempt without this storage, or one that ended before it sent, has left is not
        # there yet.
        self._sent = self._looks() if fetched else {}
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Send the rest and take away what is not here any more; OSError where that fails."""
        self._ended.set()
        self._thread.join()
        with storage_errors(self._url):
            self._send_changes()
            files, root = opened(self._url)
            here = {*self._looks(), _LAST}
            for name in _names(files, root):
                if name not in here:
                    files.rm_file(f"{root}/{name}")
            if (self._folder / _LAST).exists():
                _send(files, root, self._folder, _LAST)

    def _run(self) -> None:
        while not self._ended.wait(SEND_EVERY):
            try:
                self._send_changes()
            except Exception:
                continue

    def _send_changes(self) -> None:
        files, root = opened(self._url)
        for name, look in self._looks().items():
            if self._sent.get(name) != look:
                _send(files, root, self._folder, name)
                self._sent[name] = look

    def _looks(self) -> dict[str, tuple[int, int]]:
        """Time and size of every file but the record, by name."""
        found: dict[str, tuple[int, int]] = {}
        for path in sorted(self._folder.rglob("*")):
            name = path.relative_to(self._folder).as_posix()
            if path.name == LOCK_FILE or name == _LAST or path.name.startswith("."):
                continue
            try:
                about = path.stat()
            except FileNotFoundError:
                continue
            if path.is_file():
                found[name] = (about.st_mtime_ns, about.st_size)
        return found


def _send(files: Any, root: str, folder: Path, name: str) -> None:
    try:
        content = (folder / name).read_bytes()
    except FileNotFoundError:
        return  # Replaced or removed meanwhile: the next look sees what is there then.
    place = f"{root}/{name}"
    files.makedirs(place.rpartition("/")[0], exist_ok=True)
    # Whole or not at all, also where storage is a disk and this process is killed.
    files.pipe_file(place + _PART, content)
    files.mv(place + _PART, place)


def _names(files: Any, root: str) -> list[str]:
    """Names of all files below a folder of the storage, as paths without `..`."""
    try:
        found: list[str] = files.find(root)
    except FileNotFoundError:
        return []
    names = [PurePosixPath(one).relative_to(root) for one in found if not one.endswith(_PART)]
    return sorted(str(one) for one in names if ".." not in one.parts)


def opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    from fsspec.core import url_to_fs

    files, root = url_to_fs(url)
    # Listings that are kept would hide what another machine has sent.
    files.invalidate_cache()
    return files, root.rstrip("/")


@contextmanager
def storage_errors(url: str) -> Generator[None]:
    """Every kind of storage has errors of its own; here they are all one."""
    try:
        yield
    except Exception as error:
        told = " ".join(str(error).split()) or type(error).__name__
        raise StorageError(
            f"storage {url}: {told}; what is complete there is undamaged: mend it, then give the "
            "same command again"
        ) from error

"""One sweep at a time for a storage: no kind of storage has locks, but all keep a sign of life.

Two sweeps of one plan would run the same trials, and the one that is stopped half-way would leave
older weights beside the other one's tables.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any

from pcore.errors import InputError
from pcore.sweep.sweep_storage import opened, storage_errors

CLAIM_FILE = ".pcore-sweep"
BEAT = 5.0
"""Seconds between signs of life; nobody gives none for more than twice as long."""
_MEETING = 1.0
"""Seconds in which two that begin at once see each other."""

_LOOKS, _WRITING = 3, 0.1
"""Looks at half a sign, which on a disk is soon a whole one that says whose it is; seconds each."""


@contextmanager
def claimed(url: str) -> Generator[None]:
    """Hold a storage for one sweep.

    Whether a sign is one of life is seen by whether it changes: clocks of machines differ.

    Args:
        url: of the storage, which can be written.

    Raises:
        InputError: another sweep is writing to it.
        OSError: the storage cannot be read or written.
    """
    sign = {"host": socket.gethostname(), "process": os.getpid(), "sweep": secrets.token_hex(8)}
    ended = threading.Event()
    began = time.monotonic()
    before = _read(url)
    if before is not None:
        time.sleep(2 * BEAT)
        began = time.monotonic()
        _refuse(url, before, _read(url))
    _write(url, sign, 0)
    # After a slow write another one may be past its meeting, whose sign is overwritten now: it is
    # seen again only with its next sign of life.
    slow = time.monotonic() - began > _MEETING / 2
    time.sleep(2 * BEAT if slow else _MEETING)
    _refuse(url, {**sign, "beat": 0}, _read(url))
    thread = threading.Thread(target=_live, args=(url, sign, ended), daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        with suppress(Exception):  # Trials say what is wrong; what stays is soon no sign of life.
            files, root = opened(url)
            files.rm_file(f"{root}/{CLAIM_FILE}")


def _refuse(url: str, before: dict[str, Any], now: dict[str, Any] | None) -> None:
    if now is not None and now != before:
        whose = f"one of process {now.get('process')} on {now.get('host')}"
        got = "one whose sign is just being written" if "unreadable" in now else whose
        raise InputError(
            f"--storage {url}: expected no other sweep that writes there, got {got}; wait for its "
            "end, or give another storage"
        )


def _live(url: str, sign: dict[str, Any], ended: threading.Event) -> None:
    beat = 0
    while not ended.wait(BEAT):
        beat += 1
        with suppress(Exception):
            _write(url, sign, beat)


def _write(url: str, sign: dict[str, Any], beat: int) -> None:
    with storage_errors(url):
        files, root = opened(url)
        files.pipe_file(f"{root}/{CLAIM_FILE}", json.dumps({**sign, "beat": beat}).encode())


def _read(url: str) -> dict[str, Any] | None:
    """The sign that is there; None where there is none."""
    content = b""
    for _ in range(_LOOKS):
        with storage_errors(url):
            files, root = opened(url)
            try:
                content = files.cat_file(f"{root}/{CLAIM_FILE}")
            except FileNotFoundError:
                return None
        try:
            found = json.loads(content)
        except ValueError:
            found = None
        if isinstance(found, dict):
            return found
        time.sleep(_WRITING)
    # Half a sign is one, too: somebody is writing it, or was killed meanwhile.
    return {"unreadable": content.hex()}

"""The folder of a demo: what it is, which parts are done, and what they cost."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from pcore.demo.machine import peak_memory
from pcore.errors import InputError
from pcore.evaluation.tables import write_json
from pcore.validation import first_names

MANIFEST = "demo.json"
_FORMAT = "pcore-demo"
_VERSION = 1


class DemoFolder:
    """Remembers in `demo.json` which stages are done, their seconds, and the peak of memory.

    A stage is done for a stamp, which tells what it was made from; another stamp makes it again.
    """

    def __init__(self, path: Path, record: dict[str, Any]) -> None:
        self.path = path
        self._record = record

    @classmethod
    def open(cls, path: Path) -> DemoFolder:
        """Open or make the folder.

        Raises:
            InputError: it is a file or holds something else than a demo.
            OSError: it cannot be made or written.
        """
        if path.exists() and not path.is_dir():
            raise InputError(f"{path} is a file: expected a folder for the demo; use another -o")
        there = [item.name for item in path.iterdir()] if path.is_dir() else []
        if there and MANIFEST not in there:
            raise InputError(
                f"{path} holds other files ({first_names(there)}): "
                "expected an empty place or the folder of an earlier `pcore demo`; use another -o"
            )
        path.mkdir(parents=True, exist_ok=True)
        record = _read(path / MANIFEST) if there else {}
        folder = cls(path, {"format": _FORMAT, "version": _VERSION, "stages": {}, **record})
        folder._save()
        return folder

    @property
    def seconds(self) -> Mapping[str, float]:
        """Seconds that each stage took, interrupted attempts included."""
        return {name: float(stage["seconds"]) for name, stage in self._stages.items()}

    @property
    def peak_memory(self) -> int | None:
        """Most memory that a process of the demo used so far, bytes; None when not known."""
        return self._record.get("peak_memory")

    def done(self, stage: str, stamp: str) -> bool:
        """Whether a stage came to its end and was made from what `stamp` says."""
        return self._stages.get(stage, {}).get("stamp") == stamp

    @contextmanager
    def timed(self, stage: str, stamp: str) -> Generator[None]:
        """Run a stage in a `with` block: its time counts always, it is done without an error."""
        start, finished = time.monotonic(), False
        try:
            yield
            finished = True
        finally:
            before = self._stages.get(stage, {"seconds": 0.0})
            # What is made anew from other things begins its account anew, too.
            spent = 0.0 if before.get("stamp") not in (None, stamp) else float(before["seconds"])
            self._stages[stage] = {
                "seconds": round(spent + time.monotonic() - start, 1),
                "stamp": stamp if finished else None,
            }
            peak = peak_memory()
            if peak is not None:
                self._record["peak_memory"] = max(peak, self.peak_memory or 0)
            self._save()

    @property
    def _stages(self) -> dict[str, dict[str, Any]]:
        return self._record["stages"]

    def _save(self) -> None:
        write_json(self.path / MANIFEST, self._record)


def stamp_of(*parts: Any) -> str:
    """Short fingerprint of JSON values and of the content of files (paths)."""
    digest = hashlib.sha256()
    for part in parts:
        content = part.read_bytes() if isinstance(part, Path) else json.dumps(part).encode()
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()[:16]


def _read(path: Path) -> dict[str, Any]:
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    record = cast("dict[str, Any]", found) if isinstance(found, dict) else {}
    if record.get("format") != _FORMAT or record.get("version") != _VERSION:
        raise InputError(
            f"{path}: expected the record of a demo (format {_FORMAT!r}, version {_VERSION}), got "
            f"{record.get('format')!r}, version {record.get('version')!r}; use another -o"
        )
    return record

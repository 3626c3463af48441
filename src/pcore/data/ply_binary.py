"""The numbers of a binary PLY file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply_header import Property
from pcore.errors import InputError

Indices = NDArray[np.int64]
Changes = Sequence[tuple[Indices, Property, NDArray[Any]]]
"""Places (N,) of a property of one number, and its new values (N,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Binary:
    """Its bytes: places count them; the first element begins at `start`."""

    content: bytes
    start: int

    @property
    def size(self) -> int:
        """Where the file ends."""
        return len(self.content)

    def width(self, dtype: np.dtype[Any]) -> int:
        """How much a number takes."""
        return dtype.itemsize

    def count(self, place: int, dtype: np.dtype[Any]) -> int:
        """Length of a list that is written at a place."""
        word = self.content[place : place + dtype.itemsize]
        order = "big" if dtype.str.startswith(">") else "little"
        return int.from_bytes(word, order, signed=dtype.kind == "i")

    def are_alike(self, place: int, step: int, number: int, dtype: np.dtype[Any]) -> bool:
        """Whether so many lengths, each a step behind the one before, are the same."""
        counts = np.ndarray((number,), dtype, buffer=self.content, offset=place, strides=(step,))
        return bool((counts == counts[0]).all())

    def values(self, places: Indices, one: Property, what: str) -> NDArray[Any]:
        """Numbers (M,) of a property at places (M,); `what` they are is for messages."""
        raw = self._bytes[places[:, None] + np.arange(one.dtype.itemsize)]
        found = np.ascontiguousarray(raw).view(one.dtype).reshape(-1)
        return found.astype(one.dtype.newbyteorder("="))

    def check_end(self, place: int, where: str) -> None:
        """Raise InputError where the file goes on behind its last element."""
        if self.content[place:].strip(b"\0 \t\r\n"):
            raise InputError(
                f"{where}: expected {place:,} bytes as its PLY header says, got {self.size:,}; it "
                "is damaged (sent as text?) or its header is of another file"
            )

    def replaced(self, changes: Changes, rows: Sequence[Indices], newline: bytes) -> bytes:
        """The file with other values; all other bytes stay."""
        content = self._bytes.copy()
        for places, one, numbers in changes:
            raw = np.ascontiguousarray(numbers.astype(one.dtype)).view(np.uint8)
            size = one.dtype.itemsize
            content[places[:, None] + np.arange(size)] = raw.reshape(-1, size)
        return content.tobytes()

    @cached_property
    def _bytes(self) -> NDArray[np.uint8]:
        return np.frombuffer(self.content, dtype=np.uint8)

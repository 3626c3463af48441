"""The numbers of a PLY file in text: words behind one another, whatever their lines."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply_binary import Changes, Indices
from pcore.data.ply_header import Property
from pcore.errors import InputError

_LONGEST = 400
"""Letters of the longest word that is still a number: a double without an exponent has 330."""
_WHOLE = re.compile(rb"[+-]?[0-9]{1,18}(\.0*)?")
_PLAIN = re.compile(rb"[+-]?[0-9]{1,19}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Text:
    """The words behind its header, which is kept as it is: places count them; as `Binary`."""

    head: bytes
    words: Sequence[bytes]
    start: int = 0

    @property
    def size(self) -> int:
        """See `Binary.size`."""
        return len(self.words)

    def width(self, dtype: np.dtype[Any]) -> int:
        """See `Binary.width`."""
        return 1

    def count(self, place: int, dtype: np.dtype[Any]) -> int:
        """See `Binary.count`; ValueError, with what is there, of none."""
        word = self.words[place]
        length = int(float(word)) if _WHOLE.fullmatch(word) else -1
        if length < 0:
            raise ValueError(_shown(word))
        return length

    def are_alike(self, place: int, step: int, number: int, dtype: np.dtype[Any]) -> bool:
        """See `Binary.are_alike`."""
        return len({*self.words[place : place + step * number : step]}) == 1

    def values(self, places: Indices, one: Property, what: str) -> NDArray[Any]:
        """See `Binary.values`; InputError of what is no such number."""
        words = [self.words[k] for k in places.tolist()]
        dtype = one.dtype.newbyteorder("=")
        numbers = _floats(words, what)
        if dtype.kind == "f":
            with np.errstate(over="ignore"):
                return numbers.astype(dtype)
        limits = np.iinfo(dtype.name)
        bad = ~((numbers == np.floor(numbers)) & (numbers >= limits.min) & (numbers <= limits.max))
        # The largest numbers of 64 bits, which a double rounds up, are no labels of anything.
        bad |= np.abs(numbers) >= 2.0**63
        if bool(bad.any()):
            raise InputError(
                f"{what}: expected whole numbers from {limits.min} to {limits.max}, which is what "
                f"its header declares ({dtype}), got {float(numbers[bad][0]):g}"
            )
        if dtype.itemsize < 8:
            return numbers.astype(dtype)
        exact = [int(w) if _PLAIN.fullmatch(w) else int(float(w)) for w in words]
        return np.array(exact, dtype=dtype)

    def check_end(self, place: int, where: str) -> None:
        """See `Binary.check_end`."""
        if place < self.size:
            raise InputError(
                f"{where}: expected {place:,} numbers as its PLY header says, got {self.size:,}; "
                "the header is of another file, or lines have more columns than it declares"
            )

    def replaced(self, changes: Changes, rows: Sequence[Indices], newline: bytes) -> bytes:
        """The file with other values; all other words stay, each of the rows on a line."""
        words = list(self.words)
        for places, one, numbers in changes:
            new = numbers.astype(one.dtype.newbyteorder("="))
            for place, number in zip(places.tolist(), new, strict=True):
                words[place] = str(number).encode()
        lines = [b" ".join(words[a:b]) for starts in rows for a, b in pairwise(starts.tolist())]
        return self.head + newline.join([*lines, b""])


def _floats(words: list[bytes], what: str) -> NDArray[np.float64]:
    if max(map(len, words), default=0) <= _LONGEST:
        try:
            return np.array(words, dtype="S").astype(np.float64) if words else np.zeros(0)
        except ValueError:
            pass
    bad = next(word for word in words if not _is_number(word))
    hint = "; write numbers with a decimal point" if b"," in bad else ""
    raise InputError(f"{what}: expected numbers, got {_shown(bad)}{hint}")


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return len(word) <= _LONGEST


def _shown(word: bytes) -> str:
    return repr(word[:40].decode("latin-1"))

"""Where the numbers of a PLY file in text are: words behind one another, whatever their lines."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply_header import Element, Header
from pcore.errors import InputError

_LONGEST = 400
"""Letters of the longest word that is still a number: a double without an exponent has 330."""
_WHOLE = re.compile(rb"[+-]?[0-9]{1,18}(\.0*)?")
_PLAIN = re.compile(rb"[+-]?[0-9]{1,19}")


@dataclass(frozen=True, kw_only=True, eq=False)
class TextRows:
    """Rows of one element.

    Attributes:
        element: its header.
        words: the words of the file behind its header.
        begins: for each row where it begins: (N + 1,) numbers of words; the last is the end.
        columns: for each property where its first value is behind a row's first word: (N,), or
            one number for all rows.
        lengths: for each property how many values it has: (N,), or one number for all rows.
        where: the file, for messages.
    """

    element: Element
    words: Sequence[bytes]
    begins: NDArray[np.int64]
    columns: tuple[NDArray[np.int64] | int, ...]
    lengths: tuple[NDArray[np.int64] | int, ...]
    where: str

    def scalars(self, one: int) -> NDArray[Any]:
        """Values (N,) of a property of one number."""
        places = self.begins[:-1] + self.columns[one]
        return self._numbers([self.words[k] for k in places.tolist()], one)

    def lists(self, one: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Lengths (N,) and values of a list property."""
        starts = (self.begins[:-1] + self.columns[one]).tolist()
        lengths = np.broadcast_to(np.asarray(self.lengths[one]), (self.element.length,))
        words = [
            word
            for start, length in zip(starts, lengths.tolist(), strict=True)
            for word in self.words[start : start + length]
        ]
        return lengths.astype(np.int64), self._numbers(words, one)

    def lines(self, values: Mapping[int, NDArray[Any]]) -> list[bytes]:
        """The rows as lines, with other values (N,) of properties of one number."""
        words = list(self.words[int(self.begins[0]) : int(self.begins[-1])])
        begins = self.begins - self.begins[0]
        for one, numbers in values.items():
            new = numbers.astype(self.element.properties[one].dtype.newbyteorder("="))
            for place, number in zip((begins[:-1] + self.columns[one]).tolist(), new, strict=True):
                words[place] = str(number).encode()
        return [b" ".join(words[a:b]) for a, b in pairwise(begins.tolist())]

    def _numbers(self, words: list[bytes], one: int) -> NDArray[Any]:
        found = self.element.properties[one]
        dtype = found.dtype.newbyteorder("=")
        what = f"{self.where}: PLY element {self.element.name!r}, property {found.name!r}"
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


def locate_text(content: bytes, header: Header, where: str) -> list[TextRows]:
    """Find the rows of all elements.

    Raises:
        InputError: the file ends within a row, or goes on behind the last one.
    """
    words = content[header.size :].split()
    place = 0
    found: list[TextRows] = []
    for element in header.elements:
        rows = _locate(words, element, place, where)
        place = int(rows.begins[-1])
        found.append(rows)
    if place < len(words):
        raise InputError(
            f"{where}: expected {place:,} numbers as its PLY header says, got {len(words):,}; the "
            "header is of another file, or lines have more columns than it declares"
        )
    return found


def _locate(words: Sequence[bytes], element: Element, place: int, where: str) -> TextRows:
    size = len(element.properties)
    if size * element.length > len(words) - place:
        raise _short(element, (len(words) - place) // size, where)
    if all(one.count is None for one in element.properties):
        begins = place + size * np.arange((element.length if size else 0) + 1)
        return TextRows(
            element=element if size else Element(name=element.name, length=0, properties=()),
            words=words,
            begins=begins,
            columns=tuple(range(size)),
            lengths=(1,) * size,
            where=where,
        )
    return _walked(words, element, place, where)


def _walked(words: Sequence[bytes], element: Element, place: int, where: str) -> TextRows:
    """Go from row to row, because each begins where the lists of the one before end."""
    shape = (len(element.properties), element.length)
    columns, lengths = np.zeros(shape, dtype=np.int64), np.ones(shape, dtype=np.int64)
    begins = np.zeros(element.length + 1, dtype=np.int64)
    for row in range(element.length):
        begins[row] = begin = place
        for k, one in enumerate(element.properties):
            if one.count is not None:
                lengths[k, row] = _length(words, place, element, row, where)
                place += 1
            columns[k, row] = place - begin
            place += int(lengths[k, row])
        if place > len(words):
            raise _short(element, row, where)
    begins[-1] = place
    return TextRows(
        element=element,
        words=words,
        begins=begins,
        columns=tuple(columns),
        lengths=tuple(lengths),
        where=where,
    )


def _length(words: Sequence[bytes], place: int, element: Element, row: int, where: str) -> int:
    if place >= len(words):
        raise _short(element, row, where)
    word = words[place]
    length = int(float(word)) if _WHOLE.fullmatch(word) else -1
    if length < 0:
        raise InputError(
            f"{where}: PLY element {element.name!r}, row {row}: expected the length of a list, got "
            f"{_shown(word)}"
        )
    if length > len(words) - place:
        raise _short(element, row, where)
    return length


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


def _short(element: Element, rows: int, where: str) -> InputError:
    return InputError(
        f"{where}: expected {element.length} of the PLY element {element.name!r} as its header "
        f"says, got {rows}; the file is truncated or damaged: export or download it again"
    )

"""Where the numbers of a binary PLY file are."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply_header import Element, Header
from pcore.errors import InputError

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class BinaryRows:
    """Rows of one element.

    Attributes:
        element: its header.
        content: (B,) the bytes of the file.
        begins: for each property where its first number is in the rows: (N,) byte numbers.
            For rows of equal size (first byte, bytes of a row).
        lengths: for each list property how long the lists are: (N,), or one number for all.
    """

    element: Element
    content: Bytes
    begins: tuple[Indices | tuple[int, int], ...]
    lengths: tuple[Indices | int, ...]

    def scalars(self, one: int) -> NDArray[Any]:
        """Values (N,) of a property of one number."""
        dtype = self.element.properties[one].dtype
        return self._gathered(self._begin(one), dtype).astype(dtype.newbyteorder("="))

    def lists(self, one: int) -> tuple[Indices, NDArray[Any]]:
        """Lengths (N,) and values of a list property."""
        dtype = self.element.properties[one].dtype
        lengths = np.broadcast_to(np.asarray(self.lengths[one]), (self.element.length,))
        lengths = lengths.astype(np.int64)
        before = np.cumsum(lengths) - lengths
        inside = np.arange(int(lengths.sum())) - np.repeat(before, lengths)
        begin = np.repeat(self._begin(one), lengths) + dtype.itemsize * inside
        return lengths, self._gathered(begin, dtype).astype(dtype.newbyteorder("="))

    def write(self, content: Bytes, one: int, values: NDArray[Any]) -> None:
        """Put values (N,) of a property of one number into a copy of the file's bytes."""
        dtype = self.element.properties[one].dtype
        raw = np.ascontiguousarray(values.astype(dtype)).view(np.uint8).reshape(-1, dtype.itemsize)
        content[self._begin(one)[:, None] + np.arange(dtype.itemsize)] = raw

    def _begin(self, one: int) -> Indices:
        begin = self.begins[one]
        if isinstance(begin, tuple):
            return begin[0] + begin[1] * np.arange(self.element.length)
        return begin

    def _gathered(self, begin: Indices, dtype: np.dtype[Any]) -> NDArray[Any]:
        raw = self.content[begin[:, None] + np.arange(dtype.itemsize)]
        return np.ascontiguousarray(raw).view(dtype).reshape(-1)


def locate_binary(content: bytes, header: Header, where: str) -> list[BinaryRows]:
    """Find the rows of all elements.

    Raises:
        InputError: the file ends within a row, or goes on behind the last one.
    """
    flat = np.frombuffer(content, dtype=np.uint8)
    place = header.size
    found: list[BinaryRows] = []
    for element in header.elements:
        try:
            rows, place = _locate(flat, content, element, place)
        except _ShortError as short:
            raise InputError(
                f"{where}: expected {element.length} of the PLY element {element.name!r} as its "
                f"header says, got {short.rows}; the file is truncated or damaged: export or "
                "download it again"
            ) from None
        found.append(rows)
    rest = content[place:]
    if rest.strip(b"\0 \t\r\n"):
        raise InputError(
            f"{where}: expected {place:,} bytes as its PLY header says, got {len(content):,}; it "
            "is damaged (sent as text?) or its header is of another file"
        )
    return found


class _ShortError(Exception):
    """The file ends within the rows; how many are whole."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows


def _locate(flat: Bytes, content: bytes, element: Element, place: int) -> tuple[BinaryRows, int]:
    """Rows of one element and where the next one begins."""
    least = sum((one.count or one.dtype).itemsize for one in element.properties)
    if least * element.length > len(content) - place:
        raise _ShortError((len(content) - place) // least)
    alike = _alike(content, element, place)
    if alike is not None:
        begins, lengths, size = alike
        places = tuple((begin, size) for begin in begins)
        rows = BinaryRows(element=element, content=flat, begins=places, lengths=lengths)
        return rows, place + size * element.length
    return _walked(flat, content, element, place)


def _alike(
    content: bytes, element: Element, place: int
) -> tuple[list[int], tuple[int, ...], int] | None:
    """Begins and lengths in the first row and its size, where all rows have these lengths."""
    if not element.length or not element.properties:
        return [place] * len(element.properties), (0,) * len(element.properties), 0
    begins, lengths, end = _first_row(content, element, place)
    size = end - place
    if size * element.length > len(content) - place:
        return None
    for one, begin, length in zip(element.properties, begins, lengths, strict=True):
        if one.count is not None:
            shape, strides = (element.length,), (size,)
            first = begin - one.count.itemsize
            counts = np.ndarray(shape, one.count, buffer=content, offset=first, strides=strides)
            if not bool((counts == length).all()):
                return None
    return begins, tuple(lengths), size


def _first_row(content: bytes, element: Element, place: int) -> tuple[list[int], list[int], int]:
    begins: list[int] = []
    lengths: list[int] = []
    for one in element.properties:
        length = 1
        if one.count is not None:
            length = _count(content, place, one.count)
            place += one.count.itemsize
        begins.append(place)
        lengths.append(length)
        place += length * one.dtype.itemsize
        if length < 0 or place > len(content):
            raise _ShortError(0)
    return begins, lengths, place


def _walked(flat: Bytes, content: bytes, element: Element, place: int) -> tuple[BinaryRows, int]:
    """Go from row to row, because each begins where the lists of the one before end."""
    shape = (len(element.properties), element.length)
    begins, lengths = np.zeros(shape, dtype=np.int64), np.ones(shape, dtype=np.int64)
    for row in range(element.length):
        try:
            begins[:, row], lengths[:, row], place = _first_row(content, element, place)
        except _ShortError:
            raise _ShortError(row) from None
    rows = BinaryRows(element=element, content=flat, begins=tuple(begins), lengths=tuple(lengths))
    return rows, place


def _count(content: bytes, place: int, dtype: np.dtype[Any]) -> int:
    order = {"<": "little", ">": "big"}.get(dtype.byteorder, sys.byteorder)
    word = content[place : place + dtype.itemsize]
    return int.from_bytes(word, "big" if order == "big" else "little", signed=dtype.kind == "i")

"""Where the numbers of a PLY file are: rows of equal size are told by the first, others walked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcore.data.ply_binary import Binary, Indices
from pcore.data.ply_header import Element, Header
from pcore.data.ply_text import Text
from pcore.errors import InputError

Source = Binary | Text


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """Rows of one element.

    Attributes:
        element: its header.
        starts: (N + 1,) where each row begins; the last is the end.
        columns: for each property where its first number is behind the start of a row: (N,), or
            one number for all rows.
        lengths: for each property how many numbers it has: (N,), or one number for all rows.
    """

    element: Element
    starts: Indices
    columns: tuple[Indices | int, ...]
    lengths: tuple[Indices | int, ...]

    def begin(self, one: int) -> Indices:
        """Where the first number of a property is in every row (N,)."""
        return self.starts[:-1] + self.columns[one]

    def lists(self, one: int, width: int) -> tuple[Indices, Indices]:
        """Lengths (N,) of a list property, and places of all its numbers of a width."""
        rows = len(self.starts) - 1
        lengths = np.broadcast_to(np.asarray(self.lengths[one]), (rows,)).astype(np.int64)
        before = np.cumsum(lengths) - lengths
        inside = np.arange(int(lengths.sum())) - np.repeat(before, lengths)
        return lengths, np.repeat(self.begin(one), lengths) + width * inside


def locate(source: Source, header: Header, where: str) -> tuple[Rows, ...]:
    """Find the rows of all elements.

    Raises:
        InputError: the file ends within a row, or goes on behind the last one.
    """
    place, found = source.start, list[Rows]()
    for element in header.elements:
        try:
            found.append(_located(source, element, place))
        except _ShortError as short:
            raise InputError(
                f"{where}: expected {element.length} of the PLY element {element.name!r} as its "
                f"header says, got {short.rows}; the file is truncated or damaged: export or "
                "download it again"
            ) from None
        except _LengthError as wrong:
            raise InputError(
                f"{where}: PLY element {element.name!r}, row {wrong.row}: expected the length of a "
                f"list, got {wrong}"
            ) from None
        place = int(found[-1].starts[-1])
    source.check_end(place, where)
    return tuple(found)


class _ShortError(Exception):
    """The file ends within the rows; how many are whole."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows


class _LengthError(Exception):
    """What should be the length of a list in a row is none."""

    def __init__(self, text: str, row: int) -> None:
        super().__init__(text)
        self.row = row


def _located(source: Source, element: Element, place: int) -> Rows:
    count, properties = element.length, element.properties
    if not count or not properties:
        nothing = (0,) * len(properties)
        starts = np.array([place], dtype=np.int64)
        return Rows(element=element, starts=starts, columns=nothing, lengths=nothing)
    least = sum(source.width(one.count or one.dtype) for one in properties)
    if least * count > source.size - place:
        raise _ShortError((source.size - place) // least)
    columns, lengths, end = _row(source, element, place, 0)
    step = end - place
    alike = step * count <= source.size - place and all(
        source.are_alike(place + column - source.width(one.count), step, count, one.count)
        for one, column in zip(properties, columns, strict=True)
        if one.count is not None
    )
    if alike:
        starts = place + step * np.arange(count + 1)
        return Rows(element=element, starts=starts, columns=columns, lengths=lengths)
    # Each row begins where the lists of the one before end.
    starts, places, numbers = [place], list[tuple[int, ...]](), list[tuple[int, ...]]()
    for row in range(count):
        columns, lengths, end = _row(source, element, starts[-1], row)
        starts.append(end)
        places.append(columns)
        numbers.append(lengths)
    return Rows(
        element=element,
        starts=np.array(starts, dtype=np.int64),
        columns=tuple(np.array(places, dtype=np.int64).T),
        lengths=tuple(np.array(numbers, dtype=np.int64).T),
    )


def _row(
    source: Source, element: Element, start: int, row: int
) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Columns and lengths of one row, and where it ends."""
    place, columns, lengths = start, list[int](), list[int]()
    for one in element.properties:
        length = 1
        if one.count is not None:
            if place >= source.size:
                raise _ShortError(row)
            try:
                length = source.count(place, one.count)
            except ValueError as wrong:
                raise _LengthError(str(wrong), row) from None
            place += source.width(one.count)
        columns.append(place - start)
        lengths.append(length)
        place += length * source.width(one.dtype)
        if length < 0 or place > source.size:
            raise _ShortError(row)
    return tuple(columns), tuple(lengths), place

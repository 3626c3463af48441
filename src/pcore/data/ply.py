"""PLY files of any elements and properties: read by their header, written back with changes.

A changed file keeps what was not changed as it was: every byte of a binary file, every word of a
text file, its header, its order and its types.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply_binary import Binary, Indices
from pcore.data.ply_header import Element, Header, read_header
from pcore.data.ply_rows import Rows, Source, locate
from pcore.data.ply_text import Text

Place = tuple[int, int]
"""Numbers of an element in its file and of a property in its element."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lists:
    """Values of a list property.

    Attributes:
        lengths: (N,) int64, one for each row.
        values: (sum of lengths,) one list behind the other.
    """

    lengths: NDArray[np.int64]
    values: NDArray[Any]


@dataclass(frozen=True, kw_only=True, eq=False)
class Ply:
    """A PLY file with where its numbers are.

    Attributes:
        header: what it holds.
        source: its numbers.
        rows: where those of each element are.
        where: its name, for messages.
    """

    header: Header
    source: Source
    rows: tuple[Rows, ...]
    where: str

    def element(self, name: str) -> tuple[int, Element] | None:
        """Number and header of the first element of this name; None when there is none."""
        number = self.header.find(name)
        return None if number is None else (number, self.header.elements[number])

    def scalars(self, place: Place) -> NDArray[Any]:
        """Values (N,) of a property of one number, in its own type."""
        return self._values(place, self.rows[place[0]].begin(place[1]))

    def lists(self, place: Place) -> Lists:
        """Values of a list property."""
        rows = self.rows[place[0]]
        width = self.source.width(rows.element.properties[place[1]].dtype)
        lengths, places = rows.lists(place[1], width)
        return Lists(lengths=lengths, values=self._values(place, places))

    def replaced(self, values: Mapping[Place, NDArray[Any]]) -> bytes:
        """Write the file with other values (N,) of properties of one number, in their types."""
        changes = [
            (self.rows[element].begin(one), self.rows[element].element.properties[one], numbers)
            for (element, one), numbers in values.items()
        ]
        starts = [rows.starts for rows in self.rows]
        return self.source.replaced(changes, starts, self.header.newline)

    def _values(self, place: Place, places: Indices) -> NDArray[Any]:
        element = self.rows[place[0]].element
        one = element.properties[place[1]]
        what = f"{self.where}: PLY element {element.name!r}, property {one.name!r}"
        return self.source.values(places, one, what)


def parse_ply(content: bytes, where: str) -> Ply:
    """Read the header of a PLY file and find its numbers.

    Args:
        content: the file.
        where: its name, for messages.

    Raises:
        InputError: it is no PLY file, is cut short, or holds more or something else than its
            header says.
    """
    header = read_header(content, where)
    source: Source = Binary(content=content, start=header.size)
    if header.encoding == "ascii":
        source = Text(head=content[: header.size], words=content[header.size :].split())
    return Ply(header=header, source=source, rows=locate(source, header, where), where=where)


def binary_ply(
    columns: Mapping[str, NDArray[Any]],
    faces: NDArray[np.int64] | None = None,
    comments: tuple[str, ...] = (),
) -> bytes:
    """Write vertices, or a mesh, as a binary PLY file.

    Args:
        columns: (N,) numbers by the name of their property, whose types the file keeps.
        faces: (F, 3) vertex numbers.
        comments: their texts.
    """
    kinds = {name: values.dtype.newbyteorder("<") for name, values in columns.items()}
    count = len(next(iter(columns.values())))
    rows = np.empty(count, dtype=list(kinds.items()))
    for name, values in columns.items():
        rows[name] = values
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {one}" for one in comments)]
    lines.append(f"element vertex {count}")
    lines += [f"property {_WORDS[kind.str[1:]]} {name}" for name, kind in kinds.items()]
    body = rows.tobytes()
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        corners = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        corners["count"], corners["corners"] = 3, faces
        body += corners.tobytes()
    return "\n".join([*lines, "end_header", ""]).encode() + body


_WORDS = {
    **{"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"},
    **{"f4": "float", "f8": "double", "i8": "int64", "u8": "uint64"},
}

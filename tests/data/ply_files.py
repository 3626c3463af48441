"""Small PLY files as other tools write them, made without the reader that is tested."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

LETTERS = {
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
}
CORNERS = [(x, y, z) for x in (-1.0, 1.0) for y in (-0.5, 0.5) for z in (-1.5, 1.5)]
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1]]
TRIANGLES = [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
MIXED = [[one] for one in [*QUADS, *TRIANGLES]]
XYZ = ("float x", "float y", "float z")
FACE = ("face", ("list uchar int vertex_indices",), MIXED)

Element = tuple[str, Sequence[str], Sequence[Sequence[Any]]]


def rows(*more: Sequence[Any]) -> list[list[Any]]:
    """The corners of a box with further values."""
    return [[*place, *values] for place, *values in zip(CORNERS, *more, strict=True)]


def box(*extra: str, values: Sequence[Sequence[Any]] = (), xyz: Sequence[str] = XYZ) -> Element:
    """Vertices of a box with further properties (N values each)."""
    return ("vertex", (*xyz, *extra), rows(*values))


def ply(
    *elements: Element,
    encoding: str = "ascii",
    comments: Sequence[str] = (),
    newline: str = "\n",
) -> bytes:
    """Write a PLY file."""
    lines = ["ply", f"format {encoding} 1.0", *comments]
    body = b""
    for name, properties, values in elements:
        lines.append(f"element {name} {len(values)}")
        lines += [f"property {one}" for one in properties]
        for row in values:
            body += _row(properties, row, encoding, newline)
    head = newline.join([*lines, "end_header", ""])
    return head.encode("latin-1") + body


def _row(properties: Sequence[str], row: Sequence[Any], encoding: str, newline: str) -> bytes:
    if encoding == "ascii":
        words: list[str] = []
        for one, value in zip(properties, row, strict=True):
            if one.startswith("list"):
                words.append(str(len(value)))
            words += map(repr, value if one.startswith("list") else [value])
        return (" ".join(words) + newline).encode()
    order = ">" if encoding == "binary_big_endian" else "<"
    out = b""
    for one, value in zip(properties, row, strict=True):
        kinds = one.split()
        if kinds[0] == "list":
            out += struct.pack(order + LETTERS[kinds[1]], len(value))
            out += struct.pack(order + LETTERS[kinds[2]] * len(value), *value)
        else:
            out += struct.pack(order + LETTERS[kinds[0]], value)
    return out

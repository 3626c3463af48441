"""The header of a PLY file: which elements it holds and which properties each of them has.

The format: Turk, "The PLY Polygon File Format", 1994. Beyond its letter, what other tools write is
read too: comments and obj_info anywhere, blank lines, spaces at line ends, line ends of old
systems, a byte order mark, any encoding in comments, and one name for two properties.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pcore.data.file_kinds import kind_of
from pcore.errors import InputError

Encoding = Literal["ascii", "binary_little_endian", "binary_big_endian"]

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
    # Not of the format of 1994, but written for labels and times of scans.
    **dict.fromkeys(("long", "int64"), "i8"),
    **dict.fromkeys(("ulong", "uint64"), "u8"),
}
_ENCODINGS: dict[str, Encoding] = {
    "ascii": "ascii",
    "binary_little_endian": "binary_little_endian",
    "binary_big_endian": "binary_big_endian",
}
_MAGIC = b"ply"
_BOM = b"\xef\xbb\xbf"


@dataclass(frozen=True, kw_only=True)
class Property:
    """One property of an element.

    Attributes:
        name: as in the header.
        dtype: its numbers, in the byte order of the file.
        count: numbers of the length of a list, None for a property of one number.
    """

    name: str
    dtype: np.dtype[np.generic]
    count: np.dtype[np.generic] | None = None


@dataclass(frozen=True, kw_only=True)
class Element:
    """One element: `length` rows of the same properties."""

    name: str
    length: int
    properties: tuple[Property, ...]

    def find(self, name: str) -> int | None:
        """Which property has this name (the first of several); None when there is none."""
        return next((k for k, one in enumerate(self.properties) if one.name == name), None)


@dataclass(frozen=True, kw_only=True)
class Header:
    """What the header of a PLY file says.

    Attributes:
        encoding: how numbers are written behind the header.
        elements: in the order of the file.
        size: bytes of the header, with what ends its last line.
        newline: what ends its lines.
        comments: their texts, in the order of the file.
    """

    encoding: Encoding
    elements: tuple[Element, ...]
    size: int
    newline: bytes
    comments: tuple[str, ...] = ()

    def find(self, name: str) -> int | None:
        """Which element has this name (the first of several); None when there is none."""
        return next((k for k, one in enumerate(self.elements) if one.name == name), None)


def read_header(content: bytes, where: str) -> Header:
    """Parse the header at the beginning of a file.

    Args:
        content: the file.
        where: its name, for messages.

    Raises:
        InputError: it is no PLY, or its header is not of the format.
    """
    lines, size, newline = _lines(content, where)
    encoding: Encoding | None = None
    elements: list[Element] = []
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) > 1 and words[1] in _ENCODINGS:
            encoding = _ENCODINGS[words[1]]
        elif words[0] == "element" and len(words) == 3 and words[2].isdecimal():
            elements.append(Element(name=words[1], length=_length(words[2]), properties=()))
        elif words[0] == "property" and elements:
            one = _property(words[1:], line, where)
            last = elements[-1]
            elements[-1] = Element(
                name=last.name, length=last.length, properties=(*last.properties, one)
            )
        else:
            raise InputError(f"{where}: expected the header of a PLY file, got the line {line!r}")
    if encoding is None:
        raise InputError(
            f"{where}: expected a line such as 'format ascii 1.0' in the PLY header, got none"
        )
    order = ">" if encoding == "binary_big_endian" else "<"
    found = tuple(_ordered(one, order) for one in elements)
    comments = tuple(line[8:].strip() for line in lines if line.startswith("comment "))
    return Header(encoding=encoding, elements=found, size=size, newline=newline, comments=comments)


def _lines(content: bytes, where: str) -> tuple[list[str], int, bytes]:
    """Lines between "ply" and "end_header", stripped; bytes they take; what ends them."""
    start = len(_BOM) if content.startswith(_BOM) else 0
    if content[start : start + 3].lower() != _MAGIC or not content[start + 3 : start + 4].isspace():
        found = kind_of(content) or "a file that does not begin with a line 'ply'"
        raise InputError(f"{where}: expected a PLY with vertices x, y, z, got {found}")
    first = content[start : start + 80].lstrip(b"plyPLY \t")
    # Only files of old systems have a carriage return without a line feed behind it.
    newline = b"\r" if first[:1] == b"\r" and first[1:2] != b"\n" else b"\n"
    lines: list[str] = []
    place = start
    while True:
        end = content.find(newline, place)
        line = content[place : len(content) if end < 0 else end].strip()
        place = len(content) if end < 0 else end + len(newline)
        if line == b"end_header":
            break
        if end < 0:
            raise InputError(
                f"{where}: expected a PLY with vertices x, y, z, got one whose header has no end; "
                "the file is cut short"
            )
        # Latin-1 gives every byte a letter: comments may be in any encoding.
        lines.append(line.decode("latin-1"))
    crlf = newline == b"\n" and first.startswith(b"\r\n")
    return lines[1:], place, b"\r\n" if crlf else newline


def _length(word: str) -> int:
    # Numbers of thousands of digits take Python long; no file is larger than 2^63 rows.
    return int(word) if len(word) < 19 else 2**62


def _property(words: list[str], line: str, where: str) -> Property:
    known = [_TYPES.get(word) for word in words[:-1]]
    if len(words) == 2 and known[0] is not None:
        return Property(name=words[1], dtype=np.dtype(known[0]))
    whole = len(words) == 4 and words[0] == "list" and known[1] is not None and known[1][0] != "f"
    if whole and known[1] is not None and known[2] is not None:
        return Property(name=words[3], dtype=np.dtype(known[2]), count=np.dtype(known[1]))
    raise InputError(
        f"{where}: expected a line such as 'property float x' or 'property list uchar int "
        f"vertex_indices' in the PLY header, got {line!r}"
    )


def _ordered(element: Element, order: Literal["<", ">"]) -> Element:
    """The element with its numbers in the byte order of the file."""
    properties = tuple(
        Property(
            name=one.name,
            dtype=one.dtype.newbyteorder(order),
            count=None if one.count is None else one.count.newbyteorder(order),
        )
        for one in element.properties
    )
    return Element(name=element.name, length=element.length, properties=properties)

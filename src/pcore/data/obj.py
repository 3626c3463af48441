"""Wavefront OBJ: vertices in the order of the file, and faces; all else is left out."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pcore.errors import InputError

_FREE_FORM = ("cstype", "curv", "curv2", "surf", "bmat")


def parse_obj(content: bytes, where: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Read vertices (V, 3) and triangles (F, 3); polygons are split into fans.

    Texture coordinates and normals have numbers of their own in an OBJ, so seams split no vertex.
    Colours behind a vertex, groups, materials, lines and points are left out.

    Args:
        content: the file, in any encoding whose digits are those of ASCII.
        where: its name, for messages.

    Raises:
        InputError: a line that is not of the format, with its number; a free-form surface; or a
            face whose vertices are not in the file.
    """
    # Latin-1 gives every byte a letter: names and comments may be in any encoding.
    text = content.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(_vertex(words[1:], f"{where}: line {number}"))
        elif words[0] == "f":
            at = f"{where}: line {number}"
            corners = [_corner(word, len(vertices), at) for word in words[1:]]
            triangles += [(corners[0], one, two) for one, two in pairwise(corners[1:])]
        elif words[0] in _FREE_FORM:
            raise InputError(
                f"{where}: line {number}: free-form curves and surfaces ({words[0]}) are not read: "
                "export a mesh"
            )
    _check(triangles, len(vertices), where)
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), faces


def _vertex(words: list[str], where: str) -> list[float]:
    """Place of a vertex: x y z, with a weight of 1 or a colour behind it."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        comma = "; write numbers with a decimal point" if any("," in w for w in words) else ""
        raise InputError(
            f"{where}: expected the numbers of a vertex, got {' '.join(words)[:60]!r}{comma}"
        ) from None
    if len(values) < 3:
        raise InputError(f"{where}: expected a vertex x y z, got {len(values)} numbers")
    if len(values) == 4 and values[3] != 1:
        raise InputError(
            f"{where}: expected a vertex x y z, got one with the weight {values[3]:g}, as "
            "free-form surfaces have: export a mesh"
        )
    return values[:3]


def _corner(word: str, count: int, where: str) -> int:
    """Number of a corner's vertex from 0; negative ones count from the last vertex so far."""
    try:
        number = int(word.split("/", 1)[0])
    except ValueError:
        number = 0
    if number == 0:
        raise InputError(
            f"{where}: expected vertex numbers from 1, or negative ones, in a face, got "
            f"{word[:40]!r}"
        )
    return number - 1 if number > 0 else count + number


def _check(triangles: list[tuple[int, int, int]], count: int, where: str) -> None:
    bad = next((one for one in triangles if not (min(one) >= 0 and max(one) < count)), None)
    if bad is not None:
        raise InputError(
            f"{where}: expected faces that refer to vertices 1 to {count}, got "
            f"{', '.join(str(corner + 1) for corner in bad)}"
        )

"""Wavefront OBJ: its mesh with the vertices in the order of the file, and what paints it."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pcore.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_Corner = tuple[int, int, int]
"""Numbers of a vertex, its texture coordinate and its normal, from 0; -1 for none."""
_MOST = 2**62
"""Of a vertex number, so that a damaged one has place in an array."""
_FREE_FORM = ("cstype", "curv", "curv2", "surf", "bmat")


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjFile:
    """A mesh of polygons, split into fans of triangles.

    Texture coordinates and normals have numbers of their own in an OBJ, so seams split no vertex.

    Attributes:
        vertices: (V, 3) in the order of the file.
        colors: (V, 3) numbers behind the vertices; None unless all have them.
        faces: (F, 3) vertex numbers.
        uv: (T, 2) texture coordinates, v upwards.
        uv_faces: (F, 3) rows of `uv`, -1 for none; not checked against T.
        normals: (N, 3), of any length.
        normal_faces: (F, 3) rows of `normals`, -1 for none; not checked against N.
        materials: names of the materials in use.
        material_of_face: (F,) which of them, -1 for none.
        libraries: what stands behind each `mtllib`: one name, or several.
        flat: smoothing is switched off and never on.
    """

    vertices: FloatArray
    colors: FloatArray | None
    faces: IntArray
    uv: FloatArray
    uv_faces: IntArray
    normals: FloatArray
    normal_faces: IntArray
    materials: tuple[str, ...]
    material_of_face: IntArray
    libraries: tuple[str, ...]
    flat: bool


@dataclass(kw_only=True)
class _Lines:
    """What has been read so far."""

    vertices: list[list[float]] = field(default_factory=list[list[float]])
    uv: list[list[float]] = field(default_factory=list[list[float]])
    normals: list[list[float]] = field(default_factory=list[list[float]])
    corners: list[tuple[_Corner, _Corner, _Corner]] = field(
        default_factory=list[tuple[_Corner, _Corner, _Corner]]
    )
    materials: dict[str, int] = field(default_factory=dict[str, int])
    material_of_face: list[int] = field(default_factory=list[int])
    material: int = -1
    libraries: list[str] = field(default_factory=list[str])
    smoothing: set[str] = field(default_factory=set[str])

    def read(self, words: list[str], line: str, where: str) -> None:
        """Take in one line of words, the first of which says what it is."""
        kind, rest = words[0], words[1:]
        if kind == "v":
            self.vertices.append(_vertex(rest, where))
        elif kind == "vt":
            self.uv.append([*_numbers(rest, "a texture coordinate", where), 0.0, 0.0][:2])
        elif kind == "vn":
            self.normals.append([*_numbers(rest, "a normal", where), 0.0, 0.0, 0.0][:3])
        elif kind == "f":
            counts = (len(self.vertices), len(self.uv), len(self.normals))
            corners = [_corner(word, counts, where) for word in rest]
            fan = [(corners[0], one, two) for one, two in pairwise(corners[1:])]
            self.corners += fan
            self.material_of_face += [self.material] * len(fan)
        elif kind == "usemtl":
            self.material = self.materials.setdefault(_behind(line), len(self.materials))
        elif kind == "mtllib":
            self.libraries.append(_behind(line))
        elif kind == "s" and rest:
            self.smoothing.add(rest[0])
        elif kind in _FREE_FORM:
            raise InputError(
                f"{where}: free-form curves and surfaces ({kind}) are not read: export a mesh"
            )


def parse_obj(content: bytes, where: str) -> ObjFile:
    """Read an OBJ. Groups, lines and points are left out.

    Args:
        content: the file, in any encoding whose digits are those of ASCII.
        where: its name, for messages.

    Raises:
        InputError: a line that is not of the format, with its number; a free-form surface; or a
            face whose vertices are not in the file.
    """
    content = content.removeprefix(b"\xef\xbb\xbf")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # Which gives every byte a letter.
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    found = _Lines()
    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split()
        if words:
            found.read(words, line, f"{where}: line {number}")
    corners = np.array(found.corners, dtype=np.int64).reshape(-1, 3, 3)
    _check(corners[..., 0], len(found.vertices), where)
    colored = {len(one) for one in found.vertices} == {6}
    return ObjFile(
        vertices=_table([one[:3] for one in found.vertices], 3),
        colors=_table([one[3:] for one in found.vertices], 3) if colored else None,
        faces=corners[..., 0],
        uv=_table(found.uv, 2),
        uv_faces=corners[..., 1],
        normals=_table(found.normals, 3),
        normal_faces=corners[..., 2],
        materials=tuple(found.materials),
        material_of_face=np.array(found.material_of_face, dtype=np.int64),
        libraries=tuple(found.libraries),
        flat=bool(found.smoothing) and found.smoothing <= {"off", "0"},
    )


def _table(rows: list[list[float]], columns: int) -> FloatArray:
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def _behind(line: str) -> str:
    """A name, which may hold spaces."""
    return line.strip().partition(line.split()[0])[2].strip()


def _numbers(words: list[str], what: str, where: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        comma = "; write numbers with a decimal point" if any("," in w for w in words) else ""
        raise InputError(
            f"{where}: expected the numbers of {what}, got {' '.join(words)[:60]!r}{comma}"
        ) from None


def _vertex(words: list[str], where: str) -> list[float]:
    """Place of a vertex: x y z, alone or with a colour; a weight of 1 is left out."""
    values = _numbers(words, "a vertex", where)
    if len(values) < 3:
        raise InputError(f"{where}: expected a vertex x y z, got {len(values)} numbers")
    if len(values) == 4 and values[3] != 1:
        raise InputError(
            f"{where}: expected a vertex x y z, got one with the weight {values[3]:g}, as "
            "free-form surfaces have: export a mesh"
        )
    return values if len(values) == 6 else values[:3]


def _corner(word: str, counts: tuple[int, int, int], where: str) -> _Corner:
    """Numbers from 0 of a corner; negative ones count from the last that was read so far."""
    parts = [*word.split("/"), "", ""]
    try:
        numbers = [int(part) if part else 0 for part in parts[:3]]
    except ValueError:
        numbers = [0, 0, 0]
    if numbers[0] == 0:
        raise InputError(
            f"{where}: expected corners V, V/VT, V//VN or V/VT/VN of numbers from 1, or negative "
            f"ones, in a face, got {word[:40]!r}"
        )
    place, uv, normal = (
        min(number - 1, _MOST) if number >= 0 else max(count + number, -_MOST)
        for number, count in zip(numbers, counts, strict=True)
    )
    return place, uv, normal


def _check(faces: IntArray, count: int, where: str) -> None:
    bad = faces[((faces < 0) | (faces >= count)).any(axis=1)]
    if len(bad):
        raise InputError(
            f"{where}: expected faces that refer to vertices 1 to {count}, got "
            f"{', '.join(str(corner + 1) for corner in bad[0])}"
        )

"""The points of a PLY file: places, colours and normals, whatever tool wrote them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.ply import Lists, Place, Ply, parse_ply
from pcore.data.ply_header import Element
from pcore.errors import InputError
from pcore.validation import first_names

PLACES = ("x", "y", "z")
_COLORS = (
    ("red", "green", "blue", "alpha"),
    ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
    ("r", "g", "b", "a"),
)
_NORMALS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"))
_TURNING = re.compile(
    r"(rot|scale|f_rest|cov|covariance)_\d+|[tb][xyz]|(tangent|binormal)(_[uv])?_?[xyz]"
)
"""Names of what would turn or stretch with space: of Gaussians, and of tangents."""
_CORNERS = ("vertex_indices", "vertex_index", "vertex_ids")
_NUMBERS_OF_VERTICES = ("vertex", "face", "edge", "tristrips", "material", "multi_texture_face")
"""Elements that have no places of their own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PointPly:
    """A PLY file whose vertices are points.

    Attributes:
        ply: the file.
        number: which of its elements the vertices are.
        where: its name, for messages.
    """

    ply: Ply
    number: int
    where: str

    @property
    def vertex(self) -> Element:
        """Header of the vertices."""
        return self.ply.header.elements[self.number]

    def positions(self) -> NDArray[Any]:
        """Places (N, 3), world units, of the file's type."""
        return self.values(PLACES)

    def values(self, names: Sequence[str]) -> NDArray[Any]:
        """Values (N, C) of properties that `has` knows, of the file's type."""
        return np.stack([self.ply.scalars(place) for place in self._places(names)], axis=1)

    def normals(self) -> tuple[str, ...] | None:
        """Names of the normals' properties; None where there are none."""
        return next((names for names in _NORMALS if self.has(names)), None)

    def colors(self) -> tuple[NDArray[np.uint8] | None, str]:
        """Colours (N, 3 or 4), and why there are none where the file has some."""
        names = next((names for names in _COLORS if self.has(names[:3])), None)
        if names is None:
            return None, ""
        parts = [self.ply.scalars(place) for place in self._places(names[:3])]
        painted = _eight_bits(parts)
        if painted is None:
            return None, f"its colours ({', '.join(names[:3])}) are of no known range: not read"
        if self.has(names[3:]):
            alpha = _eight_bits([self.ply.scalars(self._places(names[3:])[0])])
            painted = painted if alpha is None else np.concatenate([painted, alpha], axis=1)
        return painted, ""

    def triangles(self) -> NDArray[np.int64] | None:
        """Faces (F, 3), polygons split into fans; None of a file without faces."""
        found = self.ply.element("face")
        if found is None or not found[1].length:
            return None
        number, face = found
        one = next((k for k in map(face.find, _CORNERS) if k is not None), None)
        if one is None or face.properties[one].count is None:
            raise InputError(
                f"{self.where}: expected faces with a list 'vertex_indices', got "
                f"{first_names(p.name for p in face.properties) or 'no property'}"
            )
        return fans(self.ply.lists((number, one)))

    def moved(self, positions: NDArray[Any], maps: NDArray[Any] | None) -> bytes:
        """Write the file with its points elsewhere, all else as it is.

        Args:
            positions: (N, 3) world units.
            maps: (N, 3, 3) Jacobians that turn the normals; None of a file without.

        Raises:
            InputError: places beyond the range of the file's type.
        """
        new = dict(zip(self._places(PLACES), positions.T, strict=True))
        names = self.normals()
        if names is not None and maps is not None and self._real(names):
            old = self.values(names)
            new |= zip(self._places(names), turned(old.astype(np.float64), maps).T, strict=True)
        for (_, one), values in new.items():
            dtype = self.vertex.properties[one].dtype
            with np.errstate(over="ignore"):
                if not np.isfinite(values.astype(dtype)).all():
                    raise InputError(
                        f"{self.where}: expected moved points within the range of {dtype.name}"
                    )
        return self.ply.replaced(new)

    def can_be_moved(self) -> bool:
        """Whether its places are real numbers, which moved ones can replace."""
        return self._real(PLACES)

    def stays(self) -> tuple[str, ...]:
        """What is written as it was although space turned or moved around it: for notes."""
        left = [p.name for p in self.vertex.properties if _TURNING.fullmatch(p.name)]
        said = [f"not turned, kept as in the file: {_counted(left)}"] if left else []
        names = self.normals()
        if names is not None and not self._real(names):
            said.append("normals of whole numbers are not turned, kept as in the file")
        others = [e for e in self.ply.header.elements if e.name not in _NUMBERS_OF_VERTICES]
        if others:
            told = ", ".join(f"{one.name} ({one.length})" for one in others)
            said.append(f"not moved, kept as in the file: the PLY elements {told}")
        return tuple(said)

    def beside(self, *, colors: bool, faces: bool) -> tuple[str, ...]:
        """Names of what the file holds besides places: lost where only those are written."""
        kept = {name for names in _COLORS for name in names} if colors else set[str]()
        own = [p.name for p in self.vertex.properties if p.name not in {*PLACES, *kept}]
        skipped = {"vertex", "face"} if faces else {"vertex"}
        others = [e for e in self.ply.header.elements if e.name not in skipped and e.length]
        return (*(own and [_counted(own)]), *(f"{e.length} {e.name}" for e in others))

    def has(self, names: Sequence[str]) -> bool:
        """Whether the vertices have all of these, each of one number."""
        places = [self.vertex.find(name) for name in names]
        return all(k is not None and self.vertex.properties[k].count is None for k in places)

    def _real(self, names: Sequence[str]) -> bool:
        kinds = [self.vertex.properties[one].dtype.kind for _, one in self._places(names)]
        return kinds == ["f"] * len(names)

    def _places(self, names: Sequence[str]) -> list[Place]:
        found = [self.vertex.find(name) for name in names]
        return [(self.number, one) for one in found if one is not None]


def read_point_ply(content: bytes, where: str) -> PointPly:
    """Parse a PLY file and check that its vertices are points.

    Raises:
        InputError: see `parse_ply`; or no vertices, or vertices without x, y, z.
    """
    ply = parse_ply(content, where)
    found = ply.element("vertex")
    if found is None:
        names = first_names(one.name for one in ply.header.elements) or "none"
        raise InputError(
            f"{where}: expected a PLY with vertices x, y, z, got one with the elements {names}"
        )
    read = PointPly(ply=ply, number=found[0], where=where)
    if found[1].find("packed_position") is not None:
        raise InputError(
            f"{where}: SuperSplat's compressed PLY is not read (positions are packed): export an "
            "uncompressed one"
        )
    if not read.has(PLACES):
        names = first_names(one.name for one in found[1].properties) or "nothing"
        raise InputError(f"{where}: expected a PLY with vertices x, y, z, got ones with {names}")
    return read


def fans(polygons: Lists) -> NDArray[np.int64]:
    """Split polygons into triangles (F, 3) around their first corners; lines are left out."""
    count = np.maximum(polygons.lengths - 2, 0)
    begin = np.cumsum(polygons.lengths) - polygons.lengths
    first = np.repeat(begin, count)
    step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
    corners = polygons.values.astype(np.int64)
    return np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)


def turned(normals: NDArray[np.float64], maps: NDArray[Any]) -> NDArray[np.float64]:
    """Turn normals (N, 3) with maps (N, 3, 3), as the inverse transpose does; lengths stay.

    A normal stays orthogonal to the surface. Where a map flattens space so that nothing is known
    the old normal stays, and so do normals without length.
    """
    # The matrix of cofactors is det(J) times the inverse transpose and exists of any map.
    rows = maps.astype(np.float64)
    cofactors = np.stack(
        [np.cross(rows[:, (k + 1) % 3], rows[:, (k + 2) % 3]) for k in range(3)], 1
    )
    new = np.einsum("nij,nj->ni", cofactors, normals)
    new *= np.where(np.linalg.det(rows) < 0, -1.0, 1.0)[:, None]
    length, old = (np.linalg.norm(one, axis=1, keepdims=True) for one in (new, normals))
    known = (length > 0) & np.isfinite(length)
    return np.where(known, new * (old / np.where(known, length, 1.0)), normals)


def _eight_bits(parts: Sequence[NDArray[Any]]) -> NDArray[np.uint8] | None:
    """Channels (N,) of any type as (N, C) uint8; None where their range is not known.

    Whole numbers are of 8 bits, or of 16 where one is above 255; real numbers go from 0 to 1, or
    to 255 where one is above 1.
    """
    if all(part.dtype.itemsize == 1 for part in parts):
        return np.stack([part.view(np.uint8) for part in parts], axis=1)
    values = np.stack([part.astype(np.float64) for part in parts], axis=1)
    real = any(part.dtype.kind == "f" for part in parts)
    most = float(values.max()) if values.size else 0.0
    least = float(values.min()) if values.size else 0.0
    if not (least >= 0 and most <= (255 if real else 65535)):
        return None
    sixteen = not real and most > 255
    factor = 1 / 257 if sixteen else 255.0 if real and most <= 1 else 1.0
    return np.rint(values * factor).astype(np.uint8)


def _counted(names: Sequence[str]) -> str:
    """Up to eight names; what is numbered, such as f_rest_0 to f_rest_44, as one."""
    groups: dict[str, int] = {}
    for name in names:
        stem = name.rstrip("0123456789")
        key = stem if stem.endswith("_") and stem != name else name
        groups[key] = groups.get(key, 0) + 1
    told = [key if key in names else f"{key}* ({count})" for key, count in groups.items()]
    more = f" and {len(told) - 8} more" if len(told) > 8 else ""
    return ", ".join(told[:8]) + more

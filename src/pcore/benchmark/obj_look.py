"""The paint of a Wavefront OBJ: materials of its `.mtl` files, textures, colours of vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcore.benchmark.look import (
    FloatArray,
    Look,
    Material,
    Texture,
    linear,
    smooth_patches,
)
from pcore.benchmark.texture_pixels import texture_pixels
from pcore.data.obj import ObjFile
from pcore.errors import InputError

_BYTES = 1.0
"""Colours of vertices beyond it count to 255."""
_WHITE = Material(color=(1.0, 1.0, 1.0, 1.0))
_NONE = ("", "(null)")
"""What exporters write where faces have no material."""
_TAKES = {
    **dict.fromkeys(("-o", "-s", "-t"), 3),
    "-mm": 2,
    **dict.fromkeys(
        ("-blendu", "-blendv", "-boost", "-texres", "-clamp", "-bm", "-imfchan", "-cc"), 1
    ),
}
"""Words behind an option of a texture; where there may be fewer they are numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedObj:
    """An OBJ whose vertices are split where paint or normals change.

    Attributes:
        vertices: (V, 3) units and axes of the file.
        faces: (F, 3) in the order of the file.
        look: what is painted on it.
    """

    vertices: FloatArray
    faces: NDArray[np.int64]
    look: Look


def painted_obj(obj: ObjFile, path: Path) -> PaintedObj:
    """Read the paint of an OBJ from the files beside it.

    Raises:
        InputError: files that are missing or damaged, or corners whose texture coordinates or
            normals are not in the file.
    """
    for what, rows, faces in (("vt", obj.uv, obj.uv_faces), ("vn", obj.normals, obj.normal_faces)):
        wrong = faces[(faces < -1) | (faces >= len(rows))]
        if len(wrong):
            raise InputError(
                f"{path}: expected faces that refer to {what} 1 to {len(rows)}, got "
                f"{int(wrong[0]) + 1}; the file is damaged: export it again"
            )
    for what, rows in (("texture coordinates", obj.uv), ("colours of vertices", obj.colors)):
        if rows is not None and not np.isfinite(rows).all():
            raise InputError(f"{path}: expected finite {what}, got NaN or infinity")
    materials = _by_use(obj, _materials(obj, path), path)
    plain = np.array([name not in materials for name in (*obj.materials, "")])
    bare = plain[obj.material_of_face]
    corners = [obj.faces, obj.uv_faces, obj.normal_faces, np.repeat(bare[:, None], 3, axis=1)]
    rows = np.stack(corners, axis=-1).reshape(-1, 4)
    split, vertex = np.unique(rows, axis=0, return_inverse=True)
    vertices = obj.vertices[split[:, 0]]
    colors = None if obj.colors is None else _colors(obj.colors[split[:, 0]], split[:, 3] > 0)
    # v points up in an OBJ.
    uv = _taken(obj.uv, split[:, 1]) * (1, -1) + (0, 1)
    known = obj.flat or bool((obj.normal_faces >= 0).any())
    # Scanners write NaN where they know no normal; 0 says so.
    normals = np.nan_to_num(_taken(obj.normals, split[:, 2]), posinf=0.0, neginf=0.0)
    default = Material() if colors is None else _WHITE
    look = Look(
        materials=tuple(materials.get(name, default) for name in (*obj.materials, "")),
        # The last one is that of faces without.
        material_of_face=obj.material_of_face % (len(obj.materials) + 1),
        uv=(uv,),
        colors=colors,
        smooth=smooth_patches(vertices, normals if known else None),
    )
    return PaintedObj(vertices=vertices, faces=vertex.reshape(-1, 3).astype(np.int64), look=look)


def _by_use(obj: ObjFile, found: dict[str, Material], path: Path) -> dict[str, Material]:
    """Materials by the names that the OBJ gives them; a comment may stand behind either name."""
    # Names may have a # of their own, as in `Material #25`: whole ones come first.
    known = {name.partition(" # ")[0].strip(): one for name, one in found.items()} | found
    plain = {name: name if name in known else _name(name) for name in obj.materials}
    used = {name: known[one] for name, one in plain.items() if one in known}
    shown = [obj.materials[k] for k in np.unique(obj.material_of_face).tolist() if k >= 0]
    unknown = [name for name in shown if name not in used and name not in _NONE]
    if unknown and found and obj.colors is None:
        raise InputError(
            f"{path}: expected materials of its libraries, got {', '.join(unknown)[:80]}; export "
            "it again with its .mtl"
        )
    return used


def _name(text: str) -> str:
    """A name without a comment behind it."""
    return text.partition(" #")[0].strip()


def _taken(rows: FloatArray, numbers: NDArray[np.int64]) -> FloatArray:
    """Rows by their numbers, zeros for -1."""
    return np.vstack([rows, np.zeros((1, rows.shape[1]))])[numbers]


def _colors(values: FloatArray, shown: NDArray[np.bool_]) -> FloatArray:
    """Linear RGBA (V, 4) of numbers (V, 3); white where a material paints instead."""
    top = 255.0 if values.max() > _BYTES else 1.0
    colors = np.where(shown[:, None], linear(np.clip(values / top, 0.0, 1.0)), 1.0)
    return np.column_stack([colors, np.ones(len(colors))])


def _materials(obj: ObjFile, path: Path) -> dict[str, Material]:
    """Materials of all libraries by name."""
    missing: list[str] = []
    found: dict[str, Material] = {}
    for one in obj.libraries:
        # One name with spaces, or several names.
        names = one.split() if _beside(path, one) is None else [one]
        files = {name: _beside(path, name) for name in names}
        gone = [name for name, file in files.items() if file is None]
        missing += [one] if gone == names else gone
        for file in files.values():
            found |= {} if file is None else _library(file, missing)
    if missing:
        raise InputError(
            f"{path}: expected the files of its paint beside it, missing: "
            f"{', '.join(dict.fromkeys(missing))}; bring them, or take out the lines that name them"
        )
    return found


def _library(path: Path, missing: list[str]) -> dict[str, Material]:
    """Materials of one file; textures that are not there are added to `missing`."""
    found: dict[str, Material] = {}
    name = None
    for line in path.read_bytes().decode("utf-8", "replace").splitlines():
        words = line.split()
        if len(words) < 2:
            continue
        kind = words[0].lower()
        if kind == "newmtl":
            name = line.strip()[len(kind) :].strip()
            found[name] = Material()
        elif name is not None and kind == "kd" and found[name].texture is None:
            plain = takewhile(lambda word: not word.startswith("#"), words[1:])
            found[name] = Material(color=_color([*plain], path))
        elif name is not None and kind == "map_kd":
            texture = _texture(words[1:], path, missing)
            found[name] = replace(_WHITE, texture=texture)
    return found


def _color(words: Sequence[str], path: Path) -> tuple[float, float, float, float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) not in (1, 3) or not np.isfinite(values).all():
        raise InputError(
            f"{path}: expected three numbers of a colour (Kd), got {' '.join(words)[:60]!r}"
        )
    red, green, blue = linear(np.clip(np.array(values), 0.0, 1.0)) * np.ones(3)
    return float(red), float(green), float(blue), 1.0


def _texture(words: Sequence[str], path: Path, missing: list[str]) -> Texture | None:
    """A texture with its options; v is turned to point down."""
    moved = {"-o": (0.0, 0.0), "-s": (1.0, 1.0)}
    clamped, left = False, [*words]
    while left and left[0].lower() in _TAKES:
        option = left.pop(0).lower()
        most = _TAKES[option]
        values = left[:1] if most == 1 else [*takewhile(_number, left[:most])]
        del left[: len(values)]
        if option == "-clamp":
            clamped = values == ["on"]
        elif option in moved and values:
            both = [*map(float, values), moved[option][1]]
            moved[option] = (both[0], both[1])
    name = " ".join(left)
    file = _beside(path, name)
    if file is None:
        missing.append(name)
        return None
    wrap, offset, scale = "clamp" if clamped else "repeat", moved["-o"], moved["-s"]
    return Texture(
        pixels=texture_pixels(file.read_bytes(), str(file)),
        wrap=(wrap, wrap),
        offset=(offset[0], 1.0 - scale[1] - offset[1]),
        scale=scale,
    )


def _number(word: str) -> bool:
    try:
        return isfinite(float(word))
    except ValueError:
        return False


def _beside(path: Path, name: str) -> Path | None:
    """A file that another one names; also one with Windows' separators, or another disk's path."""
    plain = name.strip('"').replace("\\", "/")
    for one in (name, plain, plain.rpartition("/")[2]):
        found = path.parent / one
        if one and found.is_file():
            return found
    return None

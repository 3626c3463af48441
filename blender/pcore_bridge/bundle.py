"""Bundles and the few kinds of files in and beside them; numpy only, no Blender."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

VERSION = 1
_NUMPY = {
    "char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4",
    "float": "<f4", "double": "<f8", "int8": "i1", "uint8": "u1", "int32": "<i4",
    "uint32": "<u4", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
_PARTS = ("points", "anchors", "cage", "proxy", "cameras")


class BridgeError(Exception):
    """What the user can mend; the message says what, and how."""


@dataclass(frozen=True)
class Mesh:
    """Vertices (V, 3) float32, triangles (F, 3) int32, colours (V, 3) in [0, 1] or None."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None


@dataclass(frozen=True)
class Bundle:
    """A folder that `pcore blender export` wrote, and what its `bundle.json` says."""

    folder: Path
    about: dict

    def file(self, part: str) -> Path:
        """Path of one of its files."""
        return self.folder / self.about["files"][part]

    def json(self, part: str) -> dict:
        """Content of one of its JSON files."""
        return _read_json(self.file(part))

    def mesh(self, part: str) -> Mesh:
        """One of its meshes, or its points."""
        return read_ply(self.file(part))


def open_bundle(path: str | Path) -> Bundle:
    """Open a bundle by its folder or its `bundle.json`.

    Raises:
        BridgeError: there is none, it is of another version, or its points are not those it names.
    """
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    about = _read_json(folder / "bundle.json")
    if not isinstance(about, dict) or about.get("version") != VERSION:
        raise BridgeError(
            f"{folder}: expected a bundle of version {VERSION}; update the add-on or run "
            "`pcore blender export` again"
        )
    files, size, fps = (about.get(key) for key in ("files", "size", "fps"))
    plain = isinstance(files, dict) and all(
        isinstance(files.get(part), str) and Path(files[part]).name == files[part]
        for part in _PARTS
    )
    axes = about.get("axes", np.eye(3).tolist())
    turned = isinstance(axes, list) and [
        len(row) for row in axes if isinstance(row, list) and all(map(_is_number, row))
    ] == [3, 3, 3]
    if not (plain and turned) or not all(_is_number(x) and x > 0 for x in (size, fps)):
        raise BridgeError(f"{folder}: bundle.json is damaged; run `pcore blender export` again")
    bundle = Bundle(folder, about)
    check_points(bundle, bundle.mesh("points").vertices)
    return bundle


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float))


def check_points(bundle: Bundle, vertices: np.ndarray) -> None:
    """Raise BridgeError unless points (N, 3) are, bit for bit, those of the run."""
    found = hashlib.sha256(np.ascontiguousarray(vertices, dtype="<f4").tobytes()).hexdigest()
    if found[:16] != bundle.about.get("points_hash"):
        raise BridgeError(
            f"the {len(vertices)} points are not those of the bundle "
            f"({bundle.about.get('point_count')}): they were edited themselves. Import the bundle "
            "again and move them with modifiers, shape keys or a lattice, not in edit mode"
        )


def read_ply(path: Path) -> Mesh:
    """Read a binary little-endian PLY with scalar vertex properties and triangles.

    Raises:
        BridgeError: it cannot be read, or is something else.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BridgeError(f"{path}: cannot be read ({error.strerror})") from error
    head, found, body = content.partition(b"end_header\n")
    try:
        if not found or b"binary_little_endian" not in head:
            raise ValueError("expected a binary little-endian PLY")
        counts, kinds = _header(head.decode("ascii"))
        row = np.dtype(kinds)
        rows = np.frombuffer(body, row, counts["vertex"])
        vertices = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float32)
        triangle = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
        faces = np.frombuffer(body, triangle, counts.get("face", 0), row.itemsize * len(rows))
        if (faces["count"] != 3).any():
            raise ValueError("expected triangles")
        if len(faces) and not 0 <= faces["corners"].min() <= faces["corners"].max() < len(rows):
            raise ValueError("a triangle names a vertex that is not there")
        if not np.isfinite(vertices).all():
            raise ValueError("expected finite places")
    except (ValueError, KeyError, UnicodeDecodeError) as error:
        raise BridgeError(f"{path}: not a mesh of a bundle ({error}); export it again") from error
    colors = None
    if "red" in (row.names or ()):
        colors = np.stack([rows[name] for name in ("red", "green", "blue")], axis=1) / 255.0
    return Mesh(vertices, faces["corners"].copy(), colors)


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write a mesh as `read_ply` reads it."""
    triangles = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, faces
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    body = np.ascontiguousarray(vertices, dtype="<f4").tobytes() + triangles.tobytes()
    write_whole(path, ("\n".join(lines) + "\n").encode() + body)


def write_json(path: Path, content: dict) -> None:
    """Write JSON, whole or not at all."""
    write_whole(path, (json.dumps(content, indent=1) + "\n").encode())


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that nobody ever sees half of it.

    Raises:
        BridgeError: the place cannot be written to.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise BridgeError(f"{path}: cannot be written ({error.strerror})") from error


def _header(text: str) -> tuple[dict[str, int], list[tuple[str, str]]]:
    counts: dict[str, int] = {}
    kinds: list[tuple[str, str]] = []
    element = ""
    for words in map(str.split, text.splitlines()):
        if words[:1] == ["element"]:
            element = words[1]
            counts[element] = int(words[2])
        elif words[:1] == ["property"] and element == "vertex":
            kinds.append((words[2], _NUMPY[words[1]]))
        elif words[:1] == ["property"] and words[1:4] != ["list", "uchar", "int"]:
            raise ValueError("expected triangles as a list of uchar and int")
    return counts, kinds


def _read_json(path: Path) -> dict:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BridgeError(
            f"{path}: cannot be read ({error.strerror}); choose a folder that "
            "`pcore blender export` wrote"
        ) from error
    except ValueError as error:
        raise BridgeError(f"{path}: not valid JSON; export the bundle again") from error

"""Small binary glTF files, made without the reader that is tested."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Builder:
    """Collects arrays and writes the file."""

    def __init__(self) -> None:
        self.binary = b""
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "accessors": [],
            "bufferViews": [],
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {}}]}],
        }

    def view(self, array: np.ndarray, dtype: str, **keys: Any) -> int:
        """Add a buffer view; returns its number."""
        content = np.asarray(array).astype(f"<{dtype}").tobytes()
        self.binary += b"\0" * (-len(self.binary) % 4)
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content), **keys}
        self.tree["bufferViews"].append(entry)
        self.binary += content
        return len(self.tree["bufferViews"]) - 1

    def array(self, array: Any, dtype: str = "f4", **keys: Any) -> int:
        """Add an accessor with its data; returns its number."""
        values = np.asarray(array)
        columns = values.shape[1] if values.ndim > 1 else 1
        view = self.view(values, dtype)
        return self.accessor(view, len(values), columns, dtype, **keys)

    def accessor(self, view: int | None, count: int, columns: int, dtype: str, **keys: Any) -> int:
        """Add an accessor; returns its number."""
        entry = {"componentType": KINDS[dtype], "count": count, "type": SHAPES[columns], **keys}
        if view is not None:
            entry["bufferView"] = view
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1

    @property
    def primitive(self) -> dict[str, Any]:
        """The only primitive."""
        return self.tree["meshes"][0]["primitives"][0]

    @property
    def node(self) -> dict[str, Any]:
        """The node of the mesh."""
        return self.tree["nodes"][0]

    def content(self) -> bytes:
        """The file."""
        self.tree.setdefault("buffers", [{"byteLength": len(self.binary)}])
        return glb(json.dumps(self.tree).encode(), self.binary)


def glb(text: bytes, binary: bytes = b"", version: int = 2) -> bytes:
    """Put a JSON and a binary chunk into a file."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if binary:
        chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return b"glTF" + struct.pack("<II", version, 12 + len(chunks)) + chunks


def cube() -> Builder:
    """A unit cube of twelve triangles."""
    made = Builder()
    made.primitive["attributes"]["POSITION"] = made.array(CUBE)
    made.primitive["indices"] = made.array(FACES.ravel(), "u2")
    return made

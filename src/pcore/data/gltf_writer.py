"""Binary glTF files: arrays, the document that names them, and the container of both."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

VERTICES, INDICES = 34962, 34963
"""What a viewer takes a buffer for."""
_TYPES = {"<f4": 5126, "<u4": 5125}
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


class GltfWriter:
    """Collects arrays and makes the content of a `.glb` file."""

    def __init__(self) -> None:
        """Begin an empty file."""
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._body = bytearray()

    def add(self, values: NDArray[Any], *, target: int | None = None, bounds: bool = False) -> int:
        """Add an array (N,) or (N, C) and return the number of its accessor.

        Args:
            values: written as uint32 where they are whole numbers, else as float32.
            target: `VERTICES` or `INDICES` of a mesh.
            bounds: write least and greatest values, as positions and times must have them.
        """
        whole = values.dtype.kind in "iu"
        stored = np.ascontiguousarray(values.astype("<u4" if whole else "<f4"))
        view = self.add_bytes(stored.tobytes())
        if target is not None:
            self._views[view]["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": _TYPES[stored.dtype.str],
            "count": len(stored),
            "type": "SCALAR" if stored.ndim == 1 else f"VEC{stored.shape[1]}",
        }
        if bounds:
            accessor["min"] = np.atleast_1d(stored.min(axis=0)).tolist()
            accessor["max"] = np.atleast_1d(stored.max(axis=0)).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def add_bytes(self, data: bytes) -> int:
        """Add bytes, such as a picture, and return the number of their view."""
        self._views.append({"buffer": 0, "byteOffset": len(self._body), "byteLength": len(data)})
        self._body += data + b"\0" * (-len(data) % 4)
        return len(self._views) - 1

    def content(self, document: dict[str, Any]) -> bytes:
        """All of the file.

        Args:
            document: scenes, nodes, meshes and what else there is besides the arrays.
        """
        whole = {
            "asset": {"version": "2.0", "generator": "pcore"},
            **document,
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._body)}],
        }
        text = json.dumps(whole, separators=(",", ":")).encode()
        # Chunks of a multiple of four bytes behind a head of twelve.
        text, body = text + b" " * (-len(text) % 4), bytes(self._body)
        size = 12 + 8 + len(text) + 8 + len(body)
        head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<II", len(text), _JSON)
        return head + text + struct.pack("<II", len(body), _BINARY) + body

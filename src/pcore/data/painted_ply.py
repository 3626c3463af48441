"""Points with colour, normal and confidence as a PLY that MeshLab and Blender read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from torch import Tensor

from pcore.data.pictures import to_bytes
from pcore.data.whole_file import write_whole
from pcore.errors import InputError

_REALS = ("x", "y", "z", "nx", "ny", "nz")
_PAINT = ("red", "green", "blue")
_SURE = "confidence"


def save_painted(
    path: Path, positions: Tensor, colors: Tensor, normals: Tensor, confidence: Tensor
) -> None:
    """Write points; replaces the file at once.

    Args:
        path: where to, .ply.
        positions: (N, 3) world units; written as float32.
        colors: (N, 3) in [0, 1].
        normals: (N, 3) unit.
        confidence: (N,) in [0, 1].

    Raises:
        InputError: numbers that are not finite, or a place that is not writable.
    """
    columns = np.concatenate([positions.numpy(), normals.numpy()], axis=1)
    if not np.isfinite(columns).all():
        raise InputError(f"{path}: expected finite points, got NaN or infinity")
    kinds = [*((name, "<f4") for name in _REALS), *((name, "u1") for name in _PAINT)]
    rows = np.empty(len(columns), dtype=[*kinds, (_SURE, "<f4")])
    for name, values in zip(_REALS, columns.T, strict=True):
        rows[name] = values
    for name, values in zip(_PAINT, to_bytes(colors).numpy().T, strict=True):
        rows[name] = values
    rows[_SURE] = confidence.numpy()
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in _REALS]
    lines += [*(f"property uchar {name}" for name in _PAINT), f"property float {_SURE}"]
    write_whole(path, "\n".join([*lines, "end_header", ""]).encode() + rows.tobytes(), "points")

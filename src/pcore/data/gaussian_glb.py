"""Gaussians as binary glTF with the extension KHR_gaussian_splatting.

Written after the text that Khronos ratified in 2026: scales and opacities as they are (earlier
drafts had the logarithm of scales), quaternions x y z w, harmonics of degree 0 to 3 in the basis
used here. A glTF file has y up: (x, y, z) is written as (x, z, -y), shapes and colours turned
along.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.data.gaussian_ply import CONSTANT
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians

HIGHEST_DEGREE = 3
"""Of the harmonics that the extension knows."""

_EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _POINTS, _ARRAY_BUFFER = 5126, 0, 34962
_UP = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
"""From z up to y up."""
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


def glb_content(gaussians: Gaussians) -> bytes:
    """Content of a `.glb` file of Gaussians (z up); degrees above 3 are left out."""
    attributes = _attributes(_turned(gaussians.detached().to("cpu", torch.float64)))
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    body = b""
    for values in attributes.values():
        data = values.astype("<f4").tobytes()
        view = {"buffer": 0, "byteOffset": len(body), "byteLength": len(data)}
        views.append({**view, "target": _ARRAY_BUFFER})
        accessors.append(_accessor(values, len(accessors)))
        body += data
    accessors[0] |= {
        "min": attributes["POSITION"].astype("<f4").min(axis=0).tolist(),
        "max": attributes["POSITION"].astype("<f4").max(axis=0).tolist(),
    }
    primitive = {
        "mode": _POINTS,
        "attributes": {name: number for number, name in enumerate(attributes)},
        "extensions": {_EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    document = {
        "asset": {"version": "2.0", "generator": "pcore"},
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(body)}],
    }
    return _container(json.dumps(document, separators=(",", ":")).encode(), body)


def _turned(gaussians: Gaussians) -> Gaussians:
    up = torch.tensor(_UP, dtype=torch.float64)
    return carried(gaussians, gaussians.means @ up.T, up.expand(len(gaussians), 3, 3))


def _attributes(own: Gaussians) -> dict[str, NDArray[np.float64]]:
    paint = (0.5 + CONSTANT * own.sh[:, 0]).clamp(0, 1)
    result = {
        "POSITION": own.means,
        # What viewers show that know points but no Gaussians.
        "COLOR_0": torch.cat([paint, own.opacities[:, None]], dim=1),
        f"{_EXTENSION}:ROTATION": own.quats.roll(-1, dims=1),
        f"{_EXTENSION}:SCALE": own.scales,
        f"{_EXTENSION}:OPACITY": own.opacities,
    }
    for degree in range(min(own.degree, HIGHEST_DEGREE) + 1):
        for k in range(2 * degree + 1):
            name = f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{k}"
            result[name] = own.sh[:, degree * degree + k]
    return {name: tensor.numpy() for name, tensor in result.items()}


def _accessor(values: NDArray[Any], view: int) -> dict[str, Any]:
    kind = "SCALAR" if values.ndim == 1 else f"VEC{values.shape[1]}"
    count = len(values)
    return {"bufferView": view, "componentType": _FLOAT, "count": count, "type": kind}


def _container(text: bytes, body: bytes) -> bytes:
    """Chunks of a multiple of four bytes behind a head of twelve."""
    text, body = text + b" " * (-len(text) % 4), body + b"\0" * (-len(body) % 4)
    size = 12 + 8 + len(text) + 8 + len(body)
    head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<II", len(text), _JSON)
    return head + text + struct.pack("<II", len(body), _BINARY) + body

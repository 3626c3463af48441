"""Gaussians as binary glTF with the extension KHR_gaussian_splatting.

Written after the text that Khronos ratified in 2026: scales and opacities as they are (earlier
drafts had the logarithm of scales), quaternions x y z w, harmonics of degree 0 to 3 in the basis
used here. A glTF file has y up: (x, y, z) is written as (x, z, -y), shapes and colours turned
along.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from pcore.data.gaussian_ply import CONSTANT
from pcore.data.gltf_writer import VERTICES, GltfWriter
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians

HIGHEST_DEGREE = 3
"""Of the harmonics that the extension knows."""

_EXTENSION = "KHR_gaussian_splatting"
_POINTS = 0
_UP = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
"""From z up to y up."""


def glb_content(gaussians: Gaussians) -> bytes:
    """Content of a `.glb` file of Gaussians (z up); degrees above 3 are left out."""
    attributes = _attributes(_turned(gaussians.detached().to("cpu", torch.float64)))
    writer = GltfWriter()
    numbers = {
        name: writer.add(values, target=VERTICES, bounds=name == "POSITION")
        for name, values in attributes.items()
    }
    primitive = {
        "mode": _POINTS,
        "attributes": numbers,
        "extensions": {_EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    return writer.content(
        {
            "extensionsUsed": [_EXTENSION],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
        }
    )


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

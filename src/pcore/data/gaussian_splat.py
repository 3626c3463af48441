"""Gaussians in `.splat` files: 32 bytes each, without harmonics of higher degree.

Three float32 of place, three of scale, red green blue and opacity as uint8, and a quaternion
w x y z as uint8 (b - 128) / 128; little endian, no header. The format of the viewer "splat" (2023).
"""

from __future__ import annotations

import numpy as np
import torch

from pcore.data.gaussian_ply import CONSTANT
from pcore.data.splat_file import SplatFile, sound
from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians

_ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("paint", "u1", 4), ("quats", "u1", 4)])
_SMALLEST = 1e-20


def read_splat(content: bytes, where: str) -> SplatFile:
    """Read the Gaussians of a `.splat` file.

    Args:
        content: the file.
        where: its name, for messages.

    Raises:
        InputError: no Gaussians, half ones, or see `sound`.
    """
    if not content or len(content) % _ROW.itemsize:
        raise InputError(
            f"{where}: expected 32 bytes for each Gaussian of a .splat file, got {len(content):,} "
            "bytes, which is no multiple; the file is cut short or of another kind"
        )
    rows = np.frombuffer(content, dtype=_ROW)
    with np.errstate(invalid="ignore"):
        means, scales = (torch.from_numpy(rows[k].astype(np.float64)) for k in ("means", "scales"))
    quats = torch.from_numpy((rows["quats"].astype(np.float64) - 128) / 128)
    paint = torch.from_numpy(rows["paint"].astype(np.float64) / 255)
    gaussians = Gaussians(
        means=means,
        quats=quats / quats.norm(dim=1, keepdim=True),
        scales=scales.clamp_min(_SMALLEST),
        opacities=paint[:, 3],
        sh=((paint[:, None, :3] - 0.5) / CONSTANT).float(),
    )
    numbers = np.arange(len(gaussians), dtype=np.int64)
    return sound(SplatFile(gaussians=gaussians, where=where, rows=numbers))


def splat_content(gaussians: Gaussians) -> bytes:
    """Content of a `.splat` file; colours are those of degree 0, and quaternions have 8 bits."""
    own = gaussians.detached().to("cpu", torch.float64)
    rows = np.empty(len(own), dtype=_ROW)
    rows["means"], rows["scales"] = own.means.numpy(), own.scales.numpy()
    shade = torch.cat([0.5 + CONSTANT * own.sh[:, 0], own.opacities[:, None]], dim=1)
    rows["paint"] = (shade * 255).round().clamp(0, 255).numpy()
    rows["quats"] = (own.quats * 128 + 128).round().clamp(0, 255).numpy()
    return rows.tobytes()

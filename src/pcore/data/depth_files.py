"""Depth and normals as files for other programs: PNG of 16 bits and EXR of real numbers."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pcore.data.whole_file import replacing, write_whole
from pcore.errors import InputError
from pcore.packages import package

_MOST = 65535


def depth_step(farthest: float) -> float:
    """World units of one step of a 16-bit PNG: 1, 2 or 5 times a power of ten.

    Args:
        farthest: depth that must fit, world units.

    Raises:
        InputError: it is not a positive number: there is no depth anywhere.
    """
    if not 0 < farthest < math.inf:
        raise InputError(
            "depth: expected pictures that show something solid, got none with a depth; do the "
            "cameras look at the object?"
        )
    least = farthest / _MOST
    power = 10.0 ** math.floor(math.log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least)


def save_depth_png(path: Path, depth: Tensor, step: float) -> None:
    """Write camera z (H, W), world units, in whole steps; 0 is where nothing is (NaN)."""
    whole = (depth.double() / step).nan_to_num(0.0).round().clamp(0, _MOST)
    picture = Image.fromarray(whole.numpy().astype(np.uint16))
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG")
    write_whole(path, buffer.getvalue(), "depth")


def require_exr() -> Any:
    """Return the package that writes EXR.

    Raises:
        DependencyError: it is not installed; call this before long work whose end is such a file.
    """
    instead = "or leave the files out with --no-exr"
    return package("OpenEXR", extra="mesh", need="writing EXR needs", instead=instead)


def save_exr(path: Path, **channels: Tensor) -> None:
    """Write planes (H, W) by the names of their channels as float32; NaN becomes infinity.

    A single plane is called Y: Blender reads noise from one that is called Z.

    Raises:
        DependencyError: the package OpenEXR is missing.
        InputError: a place that is not writable.
    """
    exr = require_exr()
    planes = {
        name: np.ascontiguousarray(torch.nan_to_num(plane.float(), nan=math.inf).numpy())
        for name, plane in channels.items()
    }
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    try:
        with replacing(path) as partial:
            exr.File(header, planes).write(str(partial))
    except (OSError, RuntimeError) as error:
        raise InputError(
            f"{path}: cannot write the picture ({error}); expected a place that can be written to"
        ) from error

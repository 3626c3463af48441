"""Where a model comes from: written into every model file."""

from __future__ import annotations

import platform
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

import pcore
from pcore.geometry.point_cloud import extent_of

Stage = Literal["pretrain", "finetune", "import"]
"""What makes weights."""

Vector = tuple[float, float, float]


def pcore_version() -> str:
    """Return the version of the installed package."""
    return pcore.__version__


def made_by(device: str) -> dict[str, Any]:
    """What computes, for records, as JSON values: results depend on it in their last bits."""
    where = torch.device(device)
    return {
        "pcore": pcore_version(),
        "commit": _commit(),
        "python": platform.python_version(),
        "torch": str(torch.__version__),
        "device": torch.cuda.get_device_name(where) if where.type == "cuda" else device,
        "threads": torch.get_num_threads(),
    }


@cache
def _commit() -> str | None:
    """Of the source tree that runs, `-dirty` where files were changed; None of a package."""
    root = Path(pcore.__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return None
    words = ("--no-optional-locks", "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")
    try:
        said = subprocess.run(
            ["git", *words], cwd=root, capture_output=True, text=True, check=False, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):  # No git here, or a disk that does not answer.
        return None
    return said.stdout.strip() or None


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a model comes from."""

    scene: str
    """Name of the scene it was trained on."""
    stage: Stage
    """What made these weights last."""
    step: int
    """Steps of that stage."""
    background: Vector
    """Colour the training images were composited on, RGB in [0, 1]."""
    extent: tuple[Vector, Vector]
    """Lower and upper corner of the canonical cloud, world units."""
    pcore: str
    """Version of pcore that wrote the file."""


def provenance_of(
    points: Tensor, background: Vector, *, scene: str, stage: Stage, step: int
) -> Provenance:
    """Describe canonical points (N, 3) and what made them, as this version of pcore."""
    lower, upper = (_vector(corner) for corner in extent_of(points))
    return Provenance(
        scene=scene,
        stage=stage,
        step=step,
        background=background,
        extent=(lower, upper),
        pcore=pcore_version(),
    )


def _vector(tensor: Tensor) -> Vector:
    x, y, z = (float(value) for value in tensor)
    return x, y, z

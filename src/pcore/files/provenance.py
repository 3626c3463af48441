"""Where a model comes from: written into every model file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor

import pcore
from pcore.geometry.point_cloud import extent_of

Stage = Literal["pretrain", "finetune", "import"]
"""What makes weights."""

Vector = tuple[float, float, float]


def pcore_version() -> str:
    """Return the version of the installed package."""
    return pcore.__version__


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

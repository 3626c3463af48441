"""What training hands over."""

from __future__ import annotations

from dataclasses import dataclass

from pcore.contrib.learned_skinning import Skinning
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr


@dataclass(frozen=True, kw_only=True)
class Trained:
    """Networks and points, ready to render.

    Attributes:
        papr: the networks, without gradients.
        cloud: the canonical points.
        step: steps of the stage that made it.
        skinning: what was trained along with them, without gradients; None where nothing was.
    """

    papr: Papr
    cloud: PointCloud
    step: int
    skinning: Skinning | None = None

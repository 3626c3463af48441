"""What training hands over."""

from __future__ import annotations

from dataclasses import dataclass

from pcore.contrib.learned_skinning import Skinning
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.render.surfel_fit import Observed


@dataclass(frozen=True, kw_only=True)
class Trained:
    """Networks and points, ready to render.

    Attributes:
        papr: the networks, without gradients.
        cloud: the canonical points.
        surfels: the surface over them; None before the end of a training.
        observed: what the training views say about the points, which the light is estimated from;
            None before the end of a training.
        step: steps of the stage that made it.
        skinning: what was trained along with them, without gradients; None where nothing was.
    """

    papr: Papr
    cloud: PointCloud
    step: int
    skinning: Skinning | None = None
    surfels: Surfels | None = None
    observed: Observed | None = None

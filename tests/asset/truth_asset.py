"""An object whose pictures are exact: a mesh behind the one door."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import MovedPoints
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.files.provenance import Provenance
from pcore.files.run_record import RunRecord
from pcore.gaussians.pinhole import surface_points
from pcore.geometry.camera import Camera
from pcore.render.image import Image


@dataclass(frozen=True, kw_only=True)
class MeshContent:
    """Draws a mesh by ray casting, painted by where it is: red grows along x, green along z."""

    vertices: np.ndarray
    faces: np.ndarray
    samples: int = 1
    light: None = None
    read_light: None = None
    surfels: None = None

    @property
    def points(self) -> Tensor:
        return torch.from_numpy(self.vertices).float()

    def pose(self, motion: Any, **how: Any) -> Tensor:
        if motion is None:
            return self.points
        return motion.positions if isinstance(motion, MovedPoints) else motion(self.points)

    def points_of(self, posed: Tensor) -> Tensor:
        return posed

    def local_maps_of(self, posed: Tensor) -> None:
        return None

    def over(self, background: Any) -> MeshContent:
        return self

    def render(self, posed: Tensor, camera: Camera, sampling: Any) -> Image:
        depth = mesh_depth(posed.double().numpy(), self.faces, camera)
        depth = torch.where(depth.isfinite(), depth, torch.nan)
        surface = surface_points(depth, camera)
        alpha = depth.isfinite().float()
        rgb = paint(surface, self.points).nan_to_num(0.0) * alpha[..., None]
        return Image(rgb=rgb, alpha=alpha, depth=depth, surface=surface)


def paint(places: Tensor, points: Tensor) -> Tensor:
    """Colours (..., 3) of places on an object with these points."""
    low, high = points.amin(dim=0), points.amax(dim=0)
    share = (places - low) / (high - low)
    return torch.stack([share[..., 0], share[..., 2], torch.full_like(share[..., 0], 0.5)], dim=-1)


def truth_asset(vertices: np.ndarray, faces: np.ndarray) -> Asset:
    content = MeshContent(vertices=np.asarray(vertices, dtype=np.float64), faces=faces)
    came = Provenance(
        scene="truth",
        stage="pretrain",
        step=1,
        background=(0.0, 0.0, 0.0),
        extent=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        pcore="0",
    )
    return Asset(content=content, provenance=came, record=RunRecord(stage="pretrain"))

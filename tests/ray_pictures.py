"""What rays say, pixel by pixel, for tests of the renderer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.render.picture import render_rays


@dataclass(frozen=True, kw_only=True)
class RayPicture:
    """Of (H, W) pixels, R being the shape of their rays: (H, W) or (H, W, S)."""

    rgb: Tensor
    """(H, W, 3)"""
    alpha: Tensor
    """(H, W)"""
    centroid: Tensor
    """(*R, 3)"""
    weights: Tensor
    """(*R, k)"""
    neighbours: Tensor
    """(*R, k)"""
    features: Tensor
    """(H, W, C) means over the rays of a pixel."""


def picture_of(
    papr: Papr, points: PointCloud | PosedCloud, rays: RayBundle, **options: Any
) -> RayPicture:
    """Render rays of points, at rest or posed."""
    posed = PosedCloud.at_rest(points) if isinstance(points, PointCloud) else points
    image = render_rays(papr, posed, rays, **options)
    hits = image.ray_hits
    return RayPicture(
        rgb=image.rgb,
        alpha=image.alpha,
        centroid=hits.centroid.reshape(*rays.shape, 3),
        weights=hits.weights.reshape(*rays.shape, -1),
        neighbours=hits.neighbours.reshape(*rays.shape, -1),
        features=hits.features.unflatten(0, (*image.alpha.shape, -1)).mean(dim=-2),
    )


def moved(cloud: PointCloud, positions: Tensor, to_rest: Tensor | None = None) -> PosedCloud:
    """Pose a cloud at other positions (N, 3), with the ways back (N, 3, 3) or without."""
    maps = None if to_rest is None else LocalMaps(to_rest=to_rest)
    return PosedCloud(cloud=cloud, positions=positions, local_maps=maps)

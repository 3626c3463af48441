"""Points of an object with what they look like, for programs that show clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.asset.asset import Asset, Posed
from pcore.asset.meshing import Progress, object_box, pictures_of
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import nearest
from pcore.geometry.surface_mesh import vertex_normals
from pcore.geometry.surfels import Surfels, known_normals, spacing_of
from pcore.render.fusion import DepthView, fuse
from pcore.render.mesh_colors import surface_colors
from pcore.render.surfel_fit import share_that_shows

_ACROSS = 200
"""Pixels along the longest side of the object."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PaintedPoints:
    """Points and what pictures of the object say about them.

    Attributes:
        positions: (N, 3) world units.
        colors: (N, 3) in [0, 1], of the surface over a point.
        normals: (N, 3) unit, outwards.
        confidence: (N,) share of the pictures a point faces that show the surface there, 0 to 1.
    """

    positions: Tensor
    colors: Tensor
    normals: Tensor
    confidence: Tensor


def painted_points(
    asset: Asset, cameras: Sequence[Camera] | None = None, *, progress: Progress | None = None
) -> PaintedPoints:
    """Paint the points of an object at rest with its own pictures.

    Args:
        asset: the object.
        cameras: see `mesh_of`.
        progress: told (pictures taken, pictures in all).

    Raises:
        InputError: nothing solid is to be seen.
    """
    positions = asset.points.float()
    box = object_box(asset)
    pixel = float((box[1] - box[0]).max()) / _ACROSS
    views = pictures_of(asset, cameras, box, pixel, progress=progress)
    surfels = _surfels(asset, views, box, pixel)
    spacing = max(pixel, spacing_of(positions))
    colors = surface_colors(surfels.places, surfels.normals, views, spacing)
    confidence = share_that_shows(surfels.places, surfels.normals, views, spacing)
    return PaintedPoints(
        positions=positions, colors=colors, normals=surfels.normals, confidence=confidence
    )


def posed_points(points: PaintedPoints, posed: Posed) -> PaintedPoints:
    """Return painted points where a pose has them, normals turned along."""
    normals, maps = points.normals, posed.local_maps
    if maps is not None:
        turned = torch.einsum("nji,nj->ni", maps.to_rest.to(normals), normals)
        normals = F.normalize(turned, dim=1)
    return PaintedPoints(
        positions=posed.points,
        colors=points.colors,
        normals=normals,
        confidence=points.confidence,
    )


def _surfels(
    asset: Asset, views: Sequence[DepthView], box: tuple[Tensor, Tensor], pixel: float
) -> Surfels:
    """Surface over all points; where nobody has estimated it, that of a mesh."""
    positions = asset.points.float()
    known = asset.content.surfels
    count = torch.zeros(len(positions))
    normals = torch.zeros_like(positions) if known is None else known.normals.float()
    heights = count if known is None else known.heights.float()
    lost = ~known_normals(normals)
    if bool(lost.any()):
        vertices, faces = fuse(views, *box, 2 * pixel)
        beside, _ = nearest(vertices, positions[lost], 1)
        normals = normals.clone()
        normals[lost] = vertex_normals(vertices, faces)[beside[:, 0]].float()
        heights = torch.where(lost, 0.0, heights)
    return Surfels.at_rest(positions, normals, heights)

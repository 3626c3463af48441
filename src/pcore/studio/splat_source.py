"""Splats of an object of any kind, at rest: what browsers draw of it."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.content import Sampling
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.neural_points import NeuralPoints
from pcore.data.gaussian_ply import CONSTANT
from pcore.errors import InputError
from pcore.gaussians.covariance import quaternions
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.splats import SplatsAtRest
from pcore.geometry.neighbours import nearest
from pcore.geometry.orbit import orbit_around
from pcore.geometry.surfels import known_normals, spacing_of
from pcore.geometry.visibility import visible_from

_VIEWS = 12
_ELEVATIONS = (-0.35, 0.35, 1.1)
_PIXELS = 128
_BESIDE = 6
_WIDE = 0.75
"""Standard deviation of a flat splat along the surface, in distances to its neighbours."""
_THIN = 0.1
"""The same across the surface, as a share of that along it."""
_OPACITY = 0.9
_GREY = 0.5


def splats_at_rest(asset: Asset) -> SplatsAtRest:
    """Gaussians as they are; neural points as flat splats over them, of one colour each.

    Raises:
        InputError: an object of another kind.
    """
    content = asset.content
    if isinstance(content, GaussianContent):
        return SplatsAtRest.of(content.gaussians)
    if isinstance(content, NeuralPoints):
        return SplatsAtRest.of(flat_gaussians(asset, content), asset.points)
    raise InputError(f"splats: expected Gaussians or neural points, got {type(content).__name__}")


def gains_of(posed: Posed) -> Tensor | None:
    """Factors (N,) on the brightness of what was posed, by its light; None where there are none."""
    content = posed.content
    gains = getattr(getattr(content, "drawn", content), "gains", None)
    if gains is None:
        return None
    return gains.detach().cpu().float().reshape(len(posed.points), -1).mean(dim=1)


def linear_of(posed: Posed) -> Tensor | None:
    """Jacobians (N, 3, 3) float64 at the points of what was posed; None where nothing moved."""
    if posed.local_maps is None:
        return None
    return torch.linalg.inv(posed.local_maps.to_rest.detach().cpu().double())


def flat_gaussians(asset: Asset, content: NeuralPoints) -> Gaussians:
    """Flat Gaussians along the pieces of surface over neural points; round where none is known.

    Measured on one run against PAPR's own pictures: docs/guide/view.md.
    """
    points, surfels = content.cloud.positions.detach().cpu().float(), content.surfels
    count = len(points)
    places = points if surfels is None else surfels.places.detach().cpu().float()
    normals = torch.zeros_like(points) if surfels is None else surfels.normals.detach().cpu()
    wide = _WIDE * _spacings(places)
    flat = known_normals(normals)
    thin = torch.where(flat, _THIN * wide, wide)
    colors = point_colors(asset, places)
    return Gaussians(
        means=places,
        quats=_turned(normals.float(), flat),
        scales=torch.stack([wide, wide, thin], dim=1),
        opacities=torch.full((count,), _OPACITY),
        sh=((colors - 0.5) / CONSTANT).unsqueeze(1),
    )


def point_colors(asset: Asset, places: Tensor) -> Tensor:
    """Colours (N, 3) in [0, 1] that pictures of an object at rest show at places (N, 3).

    The mean over the cameras of an orbit that see a place; grey where none does.
    """
    total, seen = torch.zeros_like(places), torch.zeros(len(places), 1)
    spacing = max(spacing_of(places), 1e-9)
    for elevation in _ELEVATIONS:
        for camera in orbit_around(
            places, _VIEWS // len(_ELEVATIONS), size=(_PIXELS, _PIXELS), elevation=elevation
        ):
            picture = asset.content.render(asset.pose().content, camera, Sampling(fast=True))
            column, row, _ = camera.project(places)
            x = column.long().clamp(0, _PIXELS - 1)
            y = row.long().clamp(0, _PIXELS - 1)
            shown = visible_from(places, camera, spacing) & (picture.alpha.cpu()[y, x] > _GREY)
            total += torch.where(shown[:, None], picture.rgb.cpu()[y, x].float(), 0.0)
            seen += shown[:, None]
    return torch.where(seen > 0, total / seen.clamp_min(1), _GREY).clamp(0, 1)


def _spacings(points: Tensor) -> Tensor:
    """Mean distance (N,) of points to their nearest others, world units; of one alone 1 % of 1."""
    if len(points) < 2:
        return torch.full((len(points),), 0.01)
    _, distances = nearest(points, points, min(_BESIDE + 1, len(points)))
    return distances[:, 1:].mean(dim=1).float().clamp_min(1e-9)


def _turned(normals: Tensor, known: Tensor) -> Tensor:
    """Quaternions (N, 4) that turn the third axis along normals (N, 3); none where not known."""
    third = torch.where(known[:, None], normals, torch.tensor([0.0, 0.0, 1.0]))
    aside = torch.nn.functional.one_hot(third.abs().argmin(dim=1), 3).to(third)
    first = torch.nn.functional.normalize(torch.linalg.cross(aside, third), dim=1)
    return quaternions(torch.stack([first, torch.linalg.cross(third, first), third], dim=2))

"""Neural points as splats: flat Gaussians over them, with the colours of the model's own pictures.

For showing an object while it moves. Every point becomes a disc on the surface over it, as wide as
its neighbours are apart.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.gaussians.covariance import quaternions
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import nearest
from pcore.geometry.orbit import orbit_around
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels, known_normals
from pcore.model.papr import Papr, constant
from pcore.render.image import Image, normals
from pcore.render.picture import FAST_THRESHOLD, render

_SIDE = 100
_RINGS = (-40.0, 0.0, 40.0)
_AROUND = 5
_SOLID = 0.9
_SAMPLES = 6
"""Pixels that tell the colour of a point."""
_BESIDE = 4
_WIDE, _THICK = 0.6, 0.15
"""Standard deviations along and across the surface, in distances between neighbours."""
_OPACITY = 0.95
_ZEROTH = 0.28209479177387814
"""Harmonic of degree 0."""


@torch.no_grad()
def own_splats(papr: Papr, cloud_at_rest: PosedCloud) -> Gaussians:
    """Make the Gaussians, one over each of N points, on the CPU.

    Args:
        papr: the networks.
        cloud_at_rest: the points; their surfels, where they have some, give places and normals.
    """
    points = cloud_at_rest.positions.detach().cpu().float()
    surface, facing, colors = _shown(papr, cloud_at_rest, points)
    surfels = cloud_at_rest.surfels
    normal, places = _normals(points, surfels, surface, facing)
    found, away = nearest(surface, places, _SAMPLES)
    # Pixels of the other side of a thin part are near, too, and say nothing.
    alike = (facing[found] * normal.unsqueeze(1)).sum(dim=2).clamp_min(1e-3)
    weight = (alike / away.clamp_min(1e-9 + float(away.median()) * 0.1)).unsqueeze(2)
    rgb = (weight * colors[found]).sum(dim=1) / weight.sum(dim=1)
    size = _spacing(places)
    scales = size.unsqueeze(1) * torch.tensor([_WIDE, _WIDE, _THICK])
    return Gaussians(
        means=places,
        quats=quaternions(_frames(normal)),
        scales=scales,
        opacities=torch.full_like(size, _OPACITY),
        sh=((rgb.clamp(0, 1) - 0.5) / _ZEROTH).unsqueeze(1),
    )


def _shown(papr: Papr, posed: PosedCloud, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Places (P, 3), normals (P, 3) and colours (P, 3) of the pixels of own pictures."""
    parts: list[tuple[Tensor, ...]] = []
    for degrees in _RINGS:
        cameras = orbit_around(
            points, _AROUND, size=(_SIDE, _SIDE), elevation=math.radians(degrees)
        )
        for camera in cameras:
            picture = render(papr, posed, camera, threshold=FAST_THRESHOLD, samples=1).cpu()
            parts.append(_pixels(papr, picture, camera))
    surface, facing, colors = (torch.cat(each) for each in zip(*parts, strict=True))
    return surface, facing, colors


def _pixels(papr: Papr, picture: Image, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    facing = normals(picture, camera)
    used = (picture.alpha > _SOLID) & ~facing.isnan().any(dim=-1)
    if not bool(used.any()):
        used = picture.alpha >= picture.alpha.max()
        facing = F.normalize(camera.center - picture.surface, dim=-1)
    alpha = picture.alpha[used].unsqueeze(1)
    behind = constant(papr.config.background, picture.rgb)
    straight = (picture.rgb[used] - (1 - alpha) * behind) / alpha.clamp_min(1e-6)
    return picture.surface[used], facing[used], straight


def _normals(
    points: Tensor, surfels: Surfels | None, surface: Tensor, facing: Tensor
) -> tuple[Tensor, Tensor]:
    """Unit normals (N, 3) of points, and the places (N, 3) of the surface over them."""
    found = nearest(surface, points, _SAMPLES)[0]
    shown = F.normalize(facing[found].sum(dim=1), dim=1)
    shown = torch.where(known_normals(shown).unsqueeze(1), shown, torch.eye(3)[2])
    if surfels is None:
        return shown, points
    known, places = surfels.normals.cpu().float(), surfels.places.cpu().float()
    return torch.where(known_normals(known).unsqueeze(1), known, shown), places


def _spacing(places: Tensor) -> Tensor:
    """How far each of places (N, 3) is from those beside it; 1e-3 for one alone."""
    if len(places) < 2:
        return torch.full((len(places),), 1e-3)
    away = nearest(places, places, 1 + _BESIDE)[1][:, 1:].mean(dim=1)
    middle = float(away.median()) or 1e-3
    # Strays would be discs as large as the object.
    return away.clamp(0.2 * middle, 2.5 * middle)


def _frames(normal: Tensor) -> Tensor:
    """Rotations (N, 3, 3) whose third axis is a unit normal (N, 3)."""
    across = F.one_hot(normal.abs().argmin(dim=1), 3).to(normal)
    first = F.normalize(torch.linalg.cross(across, normal), dim=1)
    return torch.stack([first, torch.linalg.cross(normal, first), normal], dim=-1)

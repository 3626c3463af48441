"""Where Gaussians begin: in the visual hull, in front of the cameras, or at points of a file."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

import torch
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from pcore.capture.coverage import ONE_SIDE, coverage
from pcore.data.held_cameras import held_cameras
from pcore.data.scene import Scene, View
from pcore.errors import InputError
from pcore.gaussians.gaussians import THINNEST, Gaussians
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.hull import hull_of
from pcore.training.near_origin import moved
from pcore.training.photo_consistency import consistent_points

_NEIGHBOURS = 3
_NEAREST, _FARTHEST = 0.3, 30.0
"""Depths of the start "views", in distances of the cameras."""
_OPPOSITE = 2.0
"""Greatest depth inside of masks, in distances of the cameras: an object ends before that."""
_BEHIND, _FAR_SHARE = 1.0, 0.3
"""Beside the points of a reconstruction: depth from which on, and share of, points farther away."""
_FEW = 100
"""Fewer points of a reconstruction do not say where things are."""
_FEW_VIEWS = 8
"""So few views from one side have too few neighbours to agree with."""
_DRAWN, _AGREED = 3, 0.8
"""Rays per point that is wanted inside of masks, and share of the masks it must lie in."""
_CONSTANT = 0.28209479177387814
"""The harmonic of degree 0."""


def camera_distance(scene: Scene) -> float:
    """Median distance of the training cameras from the scene's centre, world units."""
    distances = [float((view.camera.center - scene.center).norm()) for view in scene.split("train")]
    return statistics.median(distances)


def chosen_start(scene: Scene, start: str) -> str:
    """Where Gaussians begin: "auto" is the best of what the training views and the scene have."""
    if start != "auto":
        return start
    views = scene.split("train")
    if all(view.has_alpha for view in views):
        # A hull of views from one side is open, and what fills it stands before the object.
        gap = coverage(held_cameras(views), scene.center).gap
        return "views" if gap > ONE_SIDE and len(views) > _FEW_VIEWS else "hull"
    return "views" if scene.sparse is None or len(scene.sparse) < _FEW else "sparse"


def start_gaussians(
    scene: Scene,
    views: Sequence[View],
    config: GaussianConfig,
    generator: torch.Generator,
    origin: Tensor | None = None,
) -> Gaussians:
    """Gaussians of the distance to their neighbours, coloured as the photos show them.

    They are round; flat ones face every direction.

    Args:
        scene: says where the object is.
        views: training views that are not held out.
        config: how many and where.
        generator: of the draws.
        origin: (3,) float64 of the scene's coordinates in the world, in which files are; None: 0.

    Raises:
        InputError: "hull" without masks, or a bad file of points.
        TrainingError: masks without a common inside.
    """
    start = chosen_start(scene, config.start)
    distance = camera_distance(scene)
    if start == "hull":
        positions = hull_of(scene, views, config.points, generator, instead="views")
    elif start == "views" and all(view.has_alpha for view in views):
        positions = _consistent_in_masks(scene, config.points, views, generator)
    elif start == "views":
        positions = _consistent_and_far(config.points, views, distance, generator)
    elif start == "sparse":
        positions = _sparse_and_far(scene, config.points, views, distance, generator)
    else:
        # Reading such files takes a package that no other training needs.
        from pcore.data.points import load_points

        positions = load_points(Path(start))
        positions = positions if origin is None else moved(positions, -origin)
    spacing = _spacing(positions).clamp_min(1e-6 * distance)
    count, coefficients = len(positions), (config.degree + 1) ** 2
    sh = torch.zeros(count, coefficients, 3)
    sh[:, 0] = (mean_colors(positions, views) - 0.5) / _CONSTANT
    quats, scales = torch.zeros(count, 4), spacing[:, None].expand(-1, 3).clone()
    quats[:, 0] = 1.0
    if config.footprint.flat:
        # Every direction, as published: nobody knows the surface yet.
        quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
        scales[:, 2] *= THINNEST
    return Gaussians(
        means=positions,
        quats=quats,
        scales=scales,
        opacities=torch.full((count,), config.opacity_start),
        sh=sh,
    )


def mean_colors(positions: Tensor, views: Sequence[View]) -> Tensor:
    """Mean colour (N, 3) of the photos where points project to, weighted by alpha; grey for none.

    Colours between pixels are bilinear, so that rounding of the points changes them by rounding.
    """
    total, weight = torch.zeros(len(positions), 3), torch.zeros(len(positions), 1)
    for view in views:
        camera = view.camera
        across, down, depth = camera.project(positions)
        seen = (depth > 0) & (across >= 0) & (across < camera.width)
        seen &= (down >= 0) & (down < camera.height)
        rgba = view.rgba()
        planes = torch.cat([rgba[..., :3] * rgba[..., 3:], rgba[..., 3:]], dim=-1).permute(2, 0, 1)
        size = torch.tensor([camera.width, camera.height])
        places = 2 * torch.stack([across[seen], down[seen]], dim=-1) / size - 1
        pixels = F.grid_sample(
            planes[None], places[None, None].to(planes), padding_mode="border", align_corners=False
        )[0, :, 0].T
        total[seen] += pixels[:, :3]
        weight[seen] += pixels[:, 3:]
    return torch.where(weight > 0, total / weight.clamp_min(1e-6), 0.5)


def _sparse_and_far(
    scene: Scene,
    count: int,
    views: Sequence[View],
    distance: float,
    generator: torch.Generator,
) -> Tensor:
    """Points (count, 3) of the reconstruction, and some beyond the object where it has none.

    Raises:
        InputError: the scene has no such points.
    """
    if scene.sparse is None or not len(scene.sparse):
        raise InputError(
            f"scene {scene.name}: expected points of a reconstruction to start at, got a scene "
            'without; start from "views" or from a PLY or NPY file of points'
        )
    known = scene.sparse.positions
    most = min(len(known), int((1 - _FAR_SHARE) * count))
    known = known[torch.randperm(len(known), generator=generator)[:most]]
    far = _before_cameras(count - most, views, distance, generator, nearest=_BEHIND)
    return torch.cat([known, far])


def _consistent_and_far(
    count: int, views: Sequence[View], distance: float, generator: torch.Generator
) -> Tensor:
    """Points (count, 3) where neighbouring photos agree, and some far away."""
    near = torch.empty(0, 3)
    if len(views) > 2:
        near = consistent_points(
            int((1 - _FAR_SHARE) * count),
            views,
            _NEAREST * distance,
            _FARTHEST * distance,
            generator,
        )
    far = _before_cameras(count - len(near), views, distance, generator, nearest=_BEHIND)
    return torch.cat([near, far])


def _consistent_in_masks(
    scene: Scene, count: int, views: Sequence[View], generator: torch.Generator
) -> Tensor:
    """Points (N, 3), N <= count, where neighbouring photos agree inside of their masks.

    Raises:
        InputError: too few views, or no such point.
    """
    found, distance = torch.empty(0, 3), camera_distance(scene)
    if len(views) > 2:
        near, far = _NEAREST * distance, _OPPOSITE * distance
        found = consistent_points(_DRAWN * count, views, near, far, generator)
    found = found[(found - scene.center).norm(dim=-1) < distance]
    inside, seen = torch.zeros(len(found)), torch.zeros(len(found))
    for view in views:
        across, down, depth = view.camera.project(found)
        shown = (depth > 0) & (across >= 0) & (across < view.camera.width)
        shown &= (down >= 0) & (down < view.camera.height)
        inside[shown] += view.alpha()[down[shown].long(), across[shown].long()]
        seen += shown
    found = found[inside > _AGREED * seen]
    if len(found) < 2:
        raise InputError(
            "start of Gaussians: the photos agree on no point inside of their masks; start in the "
            "hull (--init hull)"
        )
    return found[torch.randperm(len(found), generator=generator)[:count]]


def _before_cameras(
    count: int,
    views: Sequence[View],
    distance: float,
    generator: torch.Generator,
    nearest: float = _NEAREST,
) -> Tensor:
    """Points (count, 3) on random rays of random views, evenly in the inverse of the depth."""
    which = torch.randint(len(views), (count,), generator=generator)
    places, inverse = (
        torch.rand(count, 2, generator=generator),
        torch.rand(count, generator=generator),
    )
    depths = distance / (1 / _FARTHEST + inverse * (1 / nearest - 1 / _FARTHEST))
    positions = torch.empty(count, 3)
    for index, view in enumerate(views):
        chosen, camera = which == index, view.camera
        size = torch.tensor([camera.width, camera.height])
        across, down = (places[chosen] * size).unbind(-1)
        x, y = (across - camera.cx) / camera.fx, -(down - camera.cy) / camera.fy
        local = torch.stack([x, y, -torch.ones_like(x)], dim=-1) * depths[chosen, None]
        positions[chosen] = local @ camera.world_from_camera[:3, :3].T + camera.center
    return positions


def _spacing(positions: Tensor) -> Tensor:
    """Root mean square distance (N,) to the nearest other points."""
    neighbours = min(_NEIGHBOURS, len(positions) - 1)
    if neighbours < 1:
        raise InputError("training of Gaussians: expected at least two points to start with")
    distances, _ = KDTree(positions.numpy()).query(positions.numpy(), k=neighbours + 1)
    return torch.from_numpy(distances[:, 1:]).float().square().mean(dim=-1).sqrt()

"""Where points start: a grid in a box, or the surface of the visual hull of masks."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from pcore.data.scene import Scene, View
from pcore.errors import InputError, TrainingError
from pcore.geometry.camera import Camera
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.object_region import Region

_SOLID = 0.5
_TRACE = 0.05
"""A pixel that an object covers by less shows none of it. Chosen on held-out views (ADR 12)."""
_SEEN, _SEEN_IN_REGION = 0.5, 0.15
"""Share of the views that must see a part of the hull: in a region that every view sees whole, and
in one that is known, parts of which only few views may see."""


_VOXELS, _VOXELS_OF_BOX = 64, 96
"""Voxels along the side of a cube around a region, and of one around the sphere about a box."""


class MaskedView(Protocol):
    """A view with a silhouette."""

    @property
    def camera(self) -> Camera:
        """The view's camera."""
        ...

    def alpha(self) -> Tensor:
        """(H, W) coverage."""
        ...

    def valid(self) -> Tensor | None:
        """(H, W) pixels that it shows; None: all. The others carve nothing."""
        ...


class _Mask(NamedTuple):
    camera: Camera
    inside: Tensor
    valid: Tensor | None


def grid_points(count: int, lower: Tensor, upper: Tensor) -> Tensor:
    """Regular grid of at least `count` points in a box, cut to `count`: the original's start.

    Args:
        count: number of points.
        lower: (3,) corner of the box, world units.
        upper: (3,) corner of the box.

    Returns:
        (count, 3).
    """
    side = int(np.ceil(count ** (1 / 3)))
    axes = [torch.linspace(float(lower[i]), float(upper[i]), side) for i in range(3)]
    grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 3)
    chosen = torch.linspace(0, len(grid) - 1, count).round().long()
    return grid[chosen]


def hull_points(
    count: int,
    views: Sequence[MaskedView],
    lower: Tensor,
    upper: Tensor,
    *,
    generator: torch.Generator,
    resolution: int = 128,
    region: Region | None = None,
) -> Tensor:
    """Points on the surface of the visual hull of the training masks.

    A sheet seen edge-on covers no pixel by half, and would be carved away by that one view. So what
    lies farther than a pixel from the hull of half covered pixels is carved only by pixels that
    show nothing at all. Voxels lie along axes of the capture: in another frame it has this hull.

    Args:
        count: number of points.
        views: training views with an alpha channel.
        lower: (3,) corner of a cube, turned copies of which are searched without a region.
        upper: (3,) corner of the cube, world units.
        generator: draws among the surface voxels and jitters inside them.
        resolution: voxels along the longest side of the hull's bounding box.
        region: where the object is known to be: nothing outside of it belongs to the hull.

    Returns:
        (count, 3).

    Raises:
        TrainingError: when the silhouettes have no common inside.
    """
    holding = _holding(views)
    solid = [_Mask(view.camera, view.alpha() > _SOLID, view.valid()) for view in holding]
    trace = [_Mask(view.camera, view.alpha() > _TRACE, view.valid()) for view in holding]
    axes = capture_axes([view.camera for view in views])
    coarse, size = _coarse(lower, upper, region, axes)
    inside = _inside_all(coarse @ axes.T, trace, region)
    if not bool(inside.any()):
        raise TrainingError(
            "visual hull: the training masks have no common inside; expected silhouettes of one "
            "object in consistent poses. Check the poses and the alpha channels, or start from a "
            "grid or a PLY"
        )
    kept = coarse[inside]
    fine, size = _voxels(kept.amin(dim=0) - size, kept.amax(dim=0) + size, resolution)
    places = fine @ axes.T
    core = _inside_all(places, solid, region)
    middle = axes @ kept.mean(dim=0)
    pixel = statistics.median_high(view.camera.pixel_width(middle) for view in views)
    reach = math.ceil(pixel / size)
    outside = ~_widened(core, reach)
    inside = core.clone()
    inside[outside] = _inside_all(places[outside], trace, region)
    surface = _surface_voxels(fine, inside, size)
    # A voxel more by rounding moves the choice to the next one, and not to anywhere.
    drawn = torch.rand(count, generator=generator) * len(surface)
    jitter = torch.rand(count, 3, generator=generator) - 0.5
    return (surface[drawn.long().clamp_max(len(surface) - 1)] + jitter * size) @ axes.T


def hull_of(
    scene: Scene, views: Sequence[View], count: int, generator: torch.Generator, *, instead: str
) -> Tensor:
    """Points (count, 3) as `hull_points`, where a scene has its object.

    Args:
        scene: says where that is.
        views: training views.
        count: number of points.
        generator: of the draws.
        instead: for messages, where points can start without masks.

    Raises:
        InputError: a view without a mask.
        TrainingError: when the silhouettes have no common inside.
    """
    if not all(view.has_alpha for view in views):
        raise InputError(
            f"scene {scene.name}: expected images with an alpha channel for a visual hull, got "
            f'photos without one; start from "{instead}" or from a PLY or NPY file of points'
        )
    bounds, region = (scene.lower, scene.upper), scene.region
    return hull_points(count, views, *bounds, generator=generator, region=region)


def faint_share(views: Sequence[MaskedView]) -> float:
    """Pixels that show a trace of the object, per pixel that it covers by half; median over views.

    Rims of clean masks give 0.06 to 0.1, 0.3 where the object is but 10 pixels wide. A haze around
    the object gives more, and starts points all over it (`hull_points`, ADR 12).

    Args:
        views: with an alpha channel.
    """
    shares: list[float] = []
    for view in views:
        alpha = view.alpha()
        solid = int((alpha > _SOLID).sum())
        shares.append((int((alpha > _TRACE).sum()) - solid) / max(1, solid))
    return statistics.median(shares)


def _voxels(lower: Tensor, upper: Tensor, resolution: int) -> tuple[Tensor, float]:
    """Centres of cubic voxels (X, Y, Z, 3) that fill a box, and their size."""
    size = float((upper - lower).max()) / resolution
    axes = []
    for low, high in zip(lower.tolist(), upper.tolist(), strict=True):
        steps = max(1, round((high - low) / size))
        axes.append(low + size * (torch.arange(steps) + 0.5))
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1), size


def _coarse(
    lower: Tensor, upper: Tensor, region: Region | None, axes: Tensor
) -> tuple[Tensor, float]:
    """Voxels (X, Y, Z, 3) of a region's sphere, or of a cube, along axes, and their size."""
    center, half, count = 0.5 * (lower + upper), 0.5 * float((upper - lower).max()), _VOXELS
    if region is not None:
        center, half = region.center, region.radius
        count = _VOXELS if region.box is None else _VOXELS_OF_BOX
    middle = center.to(axes) @ axes
    return _voxels(middle - half, middle + half, count)


def coarse_hull(
    views: Sequence[MaskedView], lower: Tensor, upper: Tensor, region: Region | None = None
) -> tuple[Tensor, float]:
    """Voxels (V, 3) that no mask carves away, world units, and their size; as `hull_points`.

    Args:
        views: with an alpha channel.
        lower: (3,) corner of the cube, as for `hull_points`.
        upper: (3,) corner of the cube.
        region: as for `hull_points`.
    """
    voxels, size = _coarse(lower, upper, region, axes := capture_axes([v.camera for v in views]))
    trace = [_Mask(v.camera, v.alpha() > _TRACE, v.valid()) for v in _holding(views)]
    return (voxels @ axes.T)[_inside_all(voxels @ axes.T, trace, region)], size


def _holding(views: Sequence[MaskedView]) -> Sequence[MaskedView]:
    """The views whose mask holds anything; all where none does.

    One that was lost and is black would carve all away but what this view does not see.
    """
    return [view for view in views if bool((view.alpha() > _TRACE).any())] or views


def _inside_all(voxels: Tensor, masks: Sequence[_Mask], region: Region | None) -> Tensor:
    """Which voxel centres (..., 3) enough views see and no view sees outside its mask."""
    flat = voxels.reshape(-1, 3)
    alive = torch.arange(len(flat))
    if region is not None:
        alive = alive[region.contains(flat)]
    seen = torch.zeros(len(flat), dtype=torch.int64)
    for mask in masks:
        in_view, in_mask = _look_up(flat[alive], mask)
        seen[alive[in_view]] += 1
        # What a view does not see, it cannot carve.
        alive = alive[in_mask | ~in_view]
    inside = torch.zeros(len(flat), dtype=torch.bool)
    # A corner that few views see is hardly carved, but it is no object either.
    share = _SEEN if region is None else _SEEN_IN_REGION
    inside[alive] = seen[alive] >= share * len(masks)
    return inside.reshape(voxels.shape[:-1])


def _widened(voxels: Tensor, reach: int) -> Tensor:
    """Voxels (X, Y, Z) bool with all within `reach` of them along every axis."""
    wide = voxels[None].float()
    # Axis by axis: coarse photos have pixels of many voxels.
    for axis in range(3):
        kernel, padding = [1, 1, 1], [0, 0, 0]
        kernel[axis], padding[axis] = 2 * reach + 1, reach
        wide = nn.functional.max_pool3d(wide, kernel, stride=1, padding=padding)
    return wide[0] > 0


def _look_up(points: Tensor, mask: _Mask) -> tuple[Tensor, Tensor]:
    """Which points (P, 3) the picture shows, and which of them lie in its mask."""
    camera = mask.camera
    across, down, depth = camera.project(points)
    column, row = across.floor().long(), down.floor().long()
    in_view = (depth > 0) & (column >= 0) & (column < camera.width)
    in_view &= (row >= 0) & (row < camera.height)
    row, column = row.clamp(0, camera.height - 1), column.clamp(0, camera.width - 1)
    if mask.valid is not None:
        in_view &= mask.valid[row, column]
    return in_view, mask.inside[row, column] & in_view


def _surface_voxels(voxels: Tensor, inside: Tensor, size: float) -> Tensor:
    """Centres (S, 3) of the inside voxels with a neighbour outside."""
    padded = torch.nn.functional.pad(inside, (1, 1, 1, 1, 1, 1))
    core = torch.ones_like(inside)
    for axis in range(3):
        for shift in (-1, 1):
            core &= padded.roll(shift, dims=axis)[1:-1, 1:-1, 1:-1]
    surface = voxels[inside & ~core]
    if len(surface) == 0:
        raise TrainingError(f"visual hull: no surface found with voxels of {size:.3g}")
    return surface

"""Training of a voxel radiance field on the photos of one scene, in the visual hull."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from pcore.data.images import composite
from pcore.data.scene import Scene, View, check_images, hold_out
from pcore.errors import InputError
from pcore.rivals.voxels import DEGREE, VoxelField, VoxelGrid, march

_COARSE = 48
"""Cells of the box of the scene in which the object is looked for."""
_PAIRS = 4
"""Pairs of corners that are smoothed, for each ray."""
_SLOWEST = 0.05
"""Share of the rates that is left at the end."""
_TRACE = 0.02
"""Opacity from which a pixel keeps what lies behind it."""


@dataclass(frozen=True, kw_only=True)
class VoxelConfig:
    """Numbers of the training; chosen on held-out training views of an object of our own."""

    cells: int = 56
    """Voxels along the longest side of the object."""
    steps: int = 1500
    rays: int = 1024
    density_rate: float = 0.1
    color_rate: float = 0.02
    start: float = 0.2
    """Density at the start, 1 / voxel."""
    smooth_density: float = 1e-3
    """Weight of the total variation of densities; theirs, of other units, is 1e-5."""
    smooth_color: float = 1e-2
    hold_out: int = 10
    seed: int = 0


def fit_voxels(scene: Scene, config: VoxelConfig, *, seconds: float | None = None) -> VoxelField:
    """Learn the field.

    Args:
        scene: its `train` split is used, nothing else.
        config: numbers.
        seconds: of the processor after which training ends, even before the last step.

    Raises:
        InputError: photos without masks, or masks with nothing in common.
    """
    views, _ = hold_out(scene.split("train"), every=config.hold_out)
    check_images(views)
    grid = hull_grid(scene, views, config.cells)
    draws = torch.Generator().manual_seed(config.seed)
    origins, directions, photos = _pixels(views)
    density = nn.Parameter(torch.full((grid.rows, 1), config.start))
    harmonics = nn.Parameter(torch.zeros(grid.rows, 3 * (DEGREE + 1) ** 2))
    groups = [
        {"params": [density], "lr": config.density_rate},
        {"params": [harmonics], "lr": config.color_rate},
    ]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99))
    pairs = _neighbours(grid)

    def loss() -> Tensor:
        chosen = torch.randint(len(origins), (config.rays,), generator=draws)
        color = torch.rand(3, generator=draws)
        field = VoxelField(grid=grid, values=_rows(density, harmonics))
        rgb, alpha, _ = march(field, origins[chosen], directions[chosen])
        truth = composite(photos[chosen], color)
        error = (rgb + (1 - alpha)[:, None] * color - truth).square().mean()
        some = pairs[torch.randint(len(pairs), (_PAIRS * config.rays,), generator=draws)]
        smooth = config.smooth_density * _variation(density, some)
        return error + smooth + config.smooth_color * _variation(harmonics, some)

    begin = time.process_time()
    for step in range(config.steps):
        spent = 0.0 if seconds is None else (time.process_time() - begin) / seconds
        share = max(step / config.steps, spent)
        if share >= 1:
            break
        for group, rate in zip(
            optimizer.param_groups, (config.density_rate, config.color_rate), strict=True
        ):
            group["lr"] = rate * _SLOWEST**share
        optimizer.zero_grad(set_to_none=True)
        loss().backward()
        optimizer.step()
    return VoxelField(grid=grid, values=_rows(density, harmonics).detach())


def hull_grid(scene: Scene, views: Sequence[View], cells: int) -> VoxelGrid:
    """Corners that every view that sees them shows as solid, and their neighbours.

    Args:
        scene: says where to look.
        views: with masks.
        cells: along the longest side of what the masks have in common.

    Raises:
        InputError: photos without masks, or masks with nothing in common.
    """
    if not all(view.has_alpha for view in views):
        raise InputError(
            f"scene {scene.name}: expected photos with masks for a voxel field, got some without "
            "an alpha channel; leave the method out with --methods"
        )
    step = float((scene.upper - scene.lower).max()) / _COARSE
    places = _solid(_corners(scene.lower, scene.upper, step), views)
    if not len(places):
        raise InputError(f"scene {scene.name}: the masks have nothing in common; check the poses")
    lower, upper = places.amin(dim=0) - step, places.amax(dim=0) + step
    step = float((upper - lower).max()) / cells
    corners = _corners(lower, upper, step)
    shape = corners.shape[:3]
    kept = torch.zeros(shape)
    kept[tuple(((_solid(corners, views) - lower) / step).round().long().T)] = 1
    inside = nn.functional.max_pool3d(kept[None], 3, stride=1, padding=1)[0] > 0
    index = torch.full(shape, int(inside.sum()))
    index[inside] = torch.arange(int(inside.sum()))
    return VoxelGrid(index=index, lower=lower, step=step)


def _corners(lower: Tensor, upper: Tensor, step: float) -> Tensor:
    """Places (X, Y, Z, 3) of the corners of a grid."""
    counts = ((upper - lower) / step).ceil().long() + 1
    axes = [lower[i] + step * torch.arange(int(counts[i])) for i in range(3)]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1)


def _solid(corners: Tensor, views: Sequence[View]) -> Tensor:
    """Places (S, 3) that most views see and none sees through, not even a pixel beside."""
    alive = corners.reshape(-1, 3)
    times = torch.zeros(len(alive), dtype=torch.int64)
    for view in views:
        across, down, depth = view.camera.project(alive)
        column, row = across.floor().long(), down.floor().long()
        width, height = view.camera.width, view.camera.height
        seen = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        # What covers less than half of a pixel of hard masks shows in the pixel beside.
        wide = nn.functional.max_pool2d(view.alpha()[None], 3, stride=1, padding=1)[0]
        opacity = wide[row.clamp(0, height - 1), column.clamp(0, width - 1)]
        kept = ~seen | (opacity > _TRACE)
        alive, times = alive[kept], (times + seen)[kept]
    return alive[2 * times >= len(views)]


def _rows(density: Tensor, harmonics: Tensor) -> Tensor:
    rows = torch.cat([density, harmonics], dim=1)
    return torch.cat([rows, rows.new_zeros(1, rows.shape[1])])


def _pixels(views: Sequence[View]) -> tuple[Tensor, Tensor, Tensor]:
    """Rays (P, 3), (P, 3) and photos (P, 4) of the pixels that the object may be in."""
    origins: list[Tensor] = []
    directions: list[Tensor] = []
    photos: list[Tensor] = []
    for view in views:
        rgba, rays = view.rgba(), view.camera.rays()
        # Corners beside the hull reach a little beyond the masks.
        near = nn.functional.max_pool2d(rgba[None, ..., 3], 5, stride=1, padding=2)[0] > 0
        origins.append(rays.origins[near])
        directions.append(rays.directions[near])
        photos.append(rgba[near])
    return torch.cat(origins), torch.cat(directions), torch.cat(photos)


def _neighbours(grid: VoxelGrid) -> Tensor:
    """Rows (K, 2) of corners beside one another."""
    pairs: list[Tensor] = []
    for axis in range(3):
        size = grid.index.shape[axis]
        first = grid.index.narrow(axis, 0, size - 1).reshape(-1)
        second = grid.index.narrow(axis, 1, size - 1).reshape(-1)
        both = (first < grid.rows) & (second < grid.rows)
        pairs.append(torch.stack([first[both], second[both]], dim=1))
    return torch.cat(pairs)


def _variation(rows: Tensor, pairs: Tensor) -> Tensor:
    return (rows[pairs[:, 0]] - rows[pairs[:, 1]]).square().sum(dim=1).mean()

"""What points hide from one another of light from far away: shadow maps made of points."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from pcore.geometry.rays import perpendicular
from pcore.geometry.surfels import known_normals
from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.numba_bridge import as_float32
from pcore.relight.relight_config import DEFAULT, RelightConfig

_REACH = 2
"""A point covers the cells beside its own, and so matters to cells around others at twice that."""
_COVERED = np.array(
    [
        sum(
            1 << (3 * (a + 1) + b + 1)
            for a in (-1, 0, 1)
            for b in (-1, 0, 1)
            if max(abs(a - across), abs(b - along)) <= 1
        )
        for across in range(-_REACH, _REACH + 1)
        for along in range(-_REACH, _REACH + 1)
    ],
    dtype=np.int64,
)
"""Which of the nine cells around a point one in each of the 25 around it covers, a bit each."""


@dataclass(frozen=True, kw_only=True)
class Shadows:
    """What N points see towards D directions.

    Attributes:
        open: (N, D) share in [0, 1] that nothing hides; 0 where a surface faces away.
        hider: (N, D) int32, the point that hides the rest: the lowest above it of those that face
            it, of all where none does; the point itself where nothing hides anything.
    """

    open: Tensor
    hider: Tensor


@torch.no_grad()
def shadows_of(
    points: Tensor,
    normals: Tensor,
    directions: Tensor,
    spacing: float,
    config: RelightConfig = DEFAULT,
) -> Shadows:
    """Tell which light from D directions reaches N points past the others, and what hides the rest.

    Across every direction lies a grid of cells. A point covers its cell and the eight around it; of
    the nine cells around a point those are open in which nothing is nearer to the light by more
    than the thickness of a surface, and before the plane of the point's own surface.

    Args:
        points: (N, 3) on the CPU, finite, world units.
        normals: (N, 3) unit; zero where a point faces everywhere.
        directions: (D, 3) unit, towards where the light comes from.
        spacing: of the points, from `pcore.geometry.visibility.cloud_spacing`, world units; 0 when
            nothing hides anything.
        config: cells and depths of the shadow maps.
    """
    count, looks = len(points), len(directions)
    hider = torch.arange(count, dtype=torch.int32)[:, None].repeat(1, looks)
    facing = as_float32(normals @ directions.to(normals).T)
    unknown = (~known_normals(normals)).numpy()
    side = float((points.amax(dim=0) - points.amin(dim=0)).norm()) if count else 0.0
    if side == 0 or spacing <= 0:
        seen = torch.from_numpy((facing > 0) | unknown[:, None])
        return Shadows(open=seen.to(torch.float32), hider=hider)
    spacing = max(spacing, side / config.shadow_finest / config.shadow_cell)
    middle = (points.amin(dim=0) + points.amax(dim=0)) / 2
    directions = directions.to(points)
    right = perpendicular(directions)
    up = torch.linalg.cross(directions, right)
    share = torch.zeros(count, looks)
    use_torch_threads()
    _hide(
        as_float32(points - middle),
        as_float32(normals),
        facing,
        unknown,
        as_float32(torch.stack([right, up, directions], dim=1)),
        np.float32(config.shadow_cell * spacing),
        np.array(config.shadow_depths, dtype=np.float32) * np.float32(spacing),
        share.numpy(),
        hider.numpy(),
    )
    return Shadows(open=share, hider=hider)


@numba.njit(cache=True, parallel=True)
def _hide(
    points: np.ndarray,
    normals: np.ndarray,
    facing: np.ndarray,
    unknown: np.ndarray,
    axes: np.ndarray,
    step: np.float32,
    thick: np.ndarray,
    share: np.ndarray,
    hider: np.ndarray,
) -> None:
    for look in prange(len(axes)):
        cells, height, width, count = _cells(points, axes[look], step)
        shade = height - _thickness(facing[:, look], unknown, thick)
        start, order, top = _sorted_by_cell(cells, shade, count)
        # Cell by cell, so that what is looked at together lies together.
        there = np.empty((len(points), 6), dtype=np.float32)
        for place in range(len(points)):
            point = order[place]
            for axis in range(3):
                there[place, axis] = points[point, axis]
            there[place, 3], there[place, 4] = height[point], shade[point]
            there[place, 5] = facing[point, look]
        for place in range(len(points)):
            point = order[place]
            if there[place, 5] > 0 or unknown[point]:
                covered, lowest, down = 0, place, place
                normal = (normals[point, 0], normals[point, 1], normals[point, 2])
                for near in range(len(_COVERED)):
                    cell = cells[point] + (near // 5 - _REACH) * width + near % 5 - _REACH
                    if top[cell] > there[place, 3]:
                        inside = (int(start[cell]), int(start[cell + 1]))
                        hides, lowest, down = _hiders(place, inside, there, normal, lowest, down)
                        if hides:
                            covered |= _COVERED[near]
                share[point, look] = (9 - _bits(covered)) / 9
                hider[point, look] = order[lowest if down == place else down]


@numba.njit(cache=True)
def _hiders(
    here: int,
    inside: tuple[int, int],
    there: np.ndarray,
    normal: tuple[float, float, float],
    lowest: int,
    down: int,
) -> tuple[bool, int, int]:
    """Whether any of some points hides the light from one.

    Also the lowest of those that do and of those among them that face away from the light, the
    ones found so far included; the point itself where there is none.

    Args:
        here: row of the point.
        inside: the first row of the others, and the one after the last.
        there: (N, 6) place, height, height below which it hides, and how it faces the light.
        normal: of the point.
        lowest: row of the lowest so far.
        down: row of the lowest so far that faces away.
    """
    hides = False
    for other in range(inside[0], inside[1]):
        if there[other, 4] > there[here, 3]:
            ahead = normal[0] * (there[other, 0] - there[here, 0])
            side = normal[1] * (there[other, 1] - there[here, 1])
            ahead += side + normal[2] * (there[other, 2] - there[here, 2])
            if ahead >= 0:
                hides = True
                if lowest == here or there[other, 3] < there[lowest, 3]:
                    lowest = other
                if there[other, 5] < 0 and (down == here or there[other, 3] < there[down, 3]):
                    down = other
    return hides, lowest, down


@numba.njit(cache=True)
def _thickness(facing: np.ndarray, unknown: np.ndarray, thick: np.ndarray) -> np.ndarray:
    """How deep (N,) below a point what it hides must lie at least."""
    depth = np.empty(len(facing), dtype=np.float32)
    for point in range(len(facing)):
        if unknown[point]:
            depth[point] = thick[1]
        else:
            depth[point] = thick[0] if facing[point] < 0 else thick[2]
    return depth


@numba.njit(cache=True)
def _bits(covered: int) -> int:
    count = 0
    for cell in range(9):
        count += (covered >> cell) & 1
    return count


@numba.njit(cache=True)
def _cells(
    points: np.ndarray, axes: np.ndarray, step: np.float32
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Cell and height of every point, how many cells a row has, and how many there are in all."""
    column = np.empty(len(points), dtype=np.int64)
    row = np.empty(len(points), dtype=np.int64)
    height = np.empty(len(points), dtype=np.float32)
    for point in range(len(points)):
        x, y, z = points[point]
        column[point] = np.floor((x * axes[0, 0] + y * axes[0, 1] + z * axes[0, 2]) / step)
        row[point] = np.floor((x * axes[1, 0] + y * axes[1, 1] + z * axes[1, 2]) / step)
        height[point] = x * axes[2, 0] + y * axes[2, 1] + z * axes[2, 2]
    # Around all of them lie cells of nothing, which points at the rim look at.
    column, row = column - column.min() + _REACH, row - row.min() + _REACH
    width = row.max() + 1 + _REACH
    return column * width + row, height, width, (column.max() + 1 + _REACH) * width


@numba.njit(cache=True)
def _sorted_by_cell(
    cells: np.ndarray, height: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the points of every cell begin, the points cell by cell, and the highest in each."""
    start = np.zeros(count + 1, dtype=np.int64)
    top = np.full(count, -np.inf, dtype=np.float32)
    for point in range(len(cells)):
        cell = cells[point]
        start[cell + 1] += 1
        top[cell] = max(top[cell], height[point])
    for cell in range(count):
        start[cell + 1] += start[cell]
    free, order = start[:-1].copy(), np.empty(len(cells), dtype=np.int64)
    for point in range(len(cells)):
        order[free[cells[point]]] = point
        free[cells[point]] += 1
    return start, order, top

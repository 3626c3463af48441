"""Closed triangle meshes of implicit surfaces."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Field = Callable[[Array], Array]

_BLOCK = 8  # grid points along a side of the blocks that are sampled or skipped as a whole


def surface_nets(field: Field, lower: Array, upper: Array, step: float) -> tuple[Array, Array]:
    """Mesh the zero set of `field` by naive surface nets (Gibson 1998).

    One vertex for each grid cell that the surface crosses, at the mean of the crossings of its
    edges; one quad, cut into two triangles, around every grid edge that the surface crosses.

    Args:
        field: (M, 3) -> (M,), a distance (up to a factor 1.5), negative inside; positive on the
            whole border of the grid.
        lower: (3,) lower corner of the grid.
        upper: (3,) upper corner of the grid, rounded up to whole blocks of cells.
        step: cell size.

    Returns:
        Vertices (V, 3) float64 and faces (F, 3) int32, counter-clockwise seen from outside.
    """
    values = _sample(field, lower, upper, step)
    total = np.zeros((*values.shape, 3))
    crossings = np.zeros(values.shape, dtype=np.int32)
    edges = [np.argwhere(np.diff(values < 0, axis=axis)) for axis in range(3)]
    for axis, edge in enumerate(edges):
        end = edge + np.eye(3, dtype=int)[axis]
        a, b = values[tuple(edge.T)], values[tuple(end.T)]
        point = edge.astype(np.float64)
        point[:, axis] += a / (a - b)
        for cell in _cells_around(edge, axis):
            np.add.at(total, tuple(cell.T), point)
            np.add.at(crossings, tuple(cell.T), 1)
    active = crossings > 0
    index = np.full(values.shape, -1, dtype=np.int32)
    index[active] = np.arange(int(active.sum()), dtype=np.int32)
    vertices = lower + step * total[active] / crossings[active][:, None]
    quad = np.concatenate([_quads(index, values, edge, axis) for axis, edge in enumerate(edges)])
    return vertices, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)


def _sample(field: Field, lower: Array, upper: Array, step: float) -> Array:
    """Field values on the grid; blocks far from the surface get their centre's sign only."""
    blocks = np.ceil(((upper - lower) / step + 1) / _BLOCK).astype(int)
    corner = np.stack(np.meshgrid(*(np.arange(n) for n in blocks), indexing="ij"), -1)
    corner = _BLOCK * corner.reshape(-1, 3)
    middle = field(lower + step * (corner + 0.5 * (_BLOCK - 1)))
    # A block reaches half its diagonal from its middle, and one more cell to the next block.
    near = np.abs(middle) < 1.5 * step * np.sqrt(3) * (0.5 * _BLOCK + 1)
    inner = np.stack(np.meshgrid(*3 * (np.arange(_BLOCK),), indexing="ij"), -1).reshape(-1, 3)
    blocked = np.repeat(middle[:, None], _BLOCK**3, axis=1)
    for part in np.array_split(np.flatnonzero(near), 1 + int(near.sum()) // 64):
        points = lower + step * (corner[part, None] + inner)
        blocked[part] = field(points.reshape(-1, 3)).reshape(len(part), -1)
    values = blocked.reshape(*blocks, _BLOCK, _BLOCK, _BLOCK).transpose(0, 3, 1, 4, 2, 5)
    return values.reshape(tuple(blocks * _BLOCK))


def _cells_around(edge: Array, axis: int) -> list[Array]:
    """List the four cells that share each grid edge, in cyclic order about the edge's direction."""
    u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
    return [edge - u - v, edge - v, edge, edge - u]


def _quads(index: Array, values: Array, edge: Array, axis: int) -> Array:
    quad = np.stack([index[tuple(cell.T)] for cell in _cells_around(edge, axis)], axis=1)
    # The cyclic order is counter-clockwise seen from the edge's end, which is right where the
    # field grows along the edge; turn the other quads over.
    leaving = values[tuple(edge.T)] < 0
    quad[~leaving] = quad[~leaving][:, ::-1]
    return quad

"""Where rays meet the surface, on the CPU, a pass per ray: the first layer, planes over it."""

from __future__ import annotations

import math

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.numba_bridge import as_float32


def first_layer(
    weights: Tensor,
    points: Tensor,
    places: tuple[Tensor, Tensor],
    directions: Tensor,
    limits: tuple[float, float],
) -> tuple[Tensor, Tensor]:
    """Weights (M, k) of the points of the layer that rays meet first, and its mean place (M, 3).

    Args:
        weights: (M, k) of points, not all zero.
        points: (M, k) which those are.
        places: (N, 3) where the points are, and (N, 3) where they are at rest, world units.
        directions: (M, 3) of the rays, unit.
        limits: share of the weight in front of which nothing is a layer, and how far from the first
            of its points, at rest, a layer's points lie at most, world units.
    """
    use_torch_threads()
    kept, mean = torch.empty(weights.shape), torch.empty(len(weights), 3)
    _first_layer(
        as_float32(weights),
        points.contiguous().numpy(),
        as_float32(places[0]),
        as_float32(places[1]),
        as_float32(directions),
        np.array([limits[0], limits[1] ** 2], dtype=np.float32),
        kept.numpy(),
        mean.numpy(),
    )
    return kept, mean


@numba.njit(cache=True, parallel=True)
def _first_layer(
    weights: np.ndarray,
    points: np.ndarray,
    places: np.ndarray,
    rest: np.ndarray,
    directions: np.ndarray,
    limits: np.ndarray,
    kept: np.ndarray,
    mean: np.ndarray,
) -> None:
    count = points.shape[1]
    for ray in prange(len(points)):
        depth = np.empty(count, dtype=np.float32)
        order = np.empty(count, dtype=np.int64)
        total = np.float32(0)
        for slot in range(count):
            depth[slot] = _dot(places, points[ray, slot], directions, ray)
            total += weights[ray, slot]
            after = slot
            while after > 0 and depth[order[after - 1]] > depth[slot]:
                order[after] = order[after - 1]
                after -= 1
            order[after] = slot
        first, reached = order[count - 1], np.float32(0)
        for slot in order:
            reached += weights[ray, slot]
            if reached >= limits[0] * total:
                first = slot
                break
        x, y, z, total = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        for slot in range(count):
            point, share = points[ray, slot], weights[ray, slot]
            if _squared(rest, point, rest, int(points[ray, first])) > limits[1]:
                share = np.float32(0)
            kept[ray, slot] = share
            total += share
            x += share * places[point, 0]
            y += share * places[point, 1]
            z += share * places[point, 2]
        mean[ray, 0], mean[ray, 1], mean[ray, 2] = x / total, y / total, z / total


def intersect(
    surfels: Surfels,
    gains: Tensor | None,
    rays: RayBundle,
    weights: Tensor,
    points: Tensor,
    limits: tuple[float, ...],
) -> tuple[Tensor, Tensor | None]:
    """Places (M, 3) where rays meet surfels, gains (M,) there; see `pcore.render.surface`.

    Args:
        surfels: the planes.
        gains: (N,) of the planes; None: there are none of rays either.
        rays: (M,) world units.
        weights: (M, k) of planes, not all zero.
        points: (M, k) which those are.
        limits: least cosine of facing, that of slanting, how far before and behind its place a
            plane is met, how far from it it counts where a ray is met and where light is, world
            units, and the weight of what faces away.
    """
    use_torch_threads()
    # Where there is no light nothing is beside a point, and nothing is read of its changes.
    changes, beside = surfels.places[:0, 0], surfels.beside[:, :0]
    if gains is not None:
        changes, beside = gains.log(), surfels.beside
    found, factors = torch.empty(len(weights), 3), torch.empty(len(weights))
    _intersect(
        as_float32(surfels.places),
        as_float32(surfels.normals),
        as_float32(changes),
        beside.contiguous().numpy(),
        as_float32(rays.origins),
        as_float32(rays.directions),
        as_float32(weights),
        points.contiguous().numpy(),
        np.array(limits, dtype=np.float32),
        found.numpy(),
        factors.numpy(),
    )
    return found, None if gains is None else factors


@numba.njit(cache=True, parallel=True)
def _intersect(
    places: np.ndarray,
    normals: np.ndarray,
    changes: np.ndarray,
    beside: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    weights: np.ndarray,
    points: np.ndarray,
    limits: np.ndarray,
    found: np.ndarray,
    factors: np.ndarray,
) -> None:
    facing, hidden = limits[0], limits[5]
    for ray in prange(len(origins)):
        shown = np.float32(0)
        for slot in range(points.shape[1]):
            if _dot(normals, points[ray, slot], directions, ray) < -facing:
                shown += weights[ray, slot]
        total, mean = np.float32(0), np.float32(0)
        most, middle = np.float32(-1), points[ray, 0]
        for slot in range(points.shape[1]):
            point, share = points[ray, slot], weights[ray, slot]
            if share > 0:
                across = _dot(normals, point, directions, ray)
                if shown > hidden and across >= -facing:
                    continue
                distance, apart = _plane(
                    origins, directions, ray, places, normals, point, across, limits
                )
                share *= _nearness(apart, limits[3])
                total += share
                mean += share * distance
                if share > most:
                    most, middle = share, point
        mean /= total
        for axis in range(3):
            found[ray, axis] = origins[ray, axis] + mean * directions[ray, axis]
        factors[ray] = 1
        if beside.shape[1] > 0:
            factors[ray] = _factor(
                found, directions, ray, places, normals, changes, beside, middle, limits
            )


@numba.njit(cache=True)
def _factor(
    found: np.ndarray,
    directions: np.ndarray,
    ray: int,
    places: np.ndarray,
    normals: np.ndarray,
    changes: np.ndarray,
    beside: np.ndarray,
    middle: int,
    limits: np.ndarray,
) -> float:
    """Mean factor of the planes around a point that face a ray, where that met the surface."""
    change, total = np.float32(0), np.float32(0)
    for slot in range(beside.shape[1]):
        piece = beside[middle, slot]
        share = _nearness(_squared(places, piece, found, ray), limits[4])
        if -_dot(normals, piece, directions, ray) <= limits[0]:
            share *= limits[5]
        total += share
        change += share * changes[piece]
    return math.exp(change / total)


@numba.njit(cache=True, inline="always")
def _plane(
    origins: np.ndarray,
    directions: np.ndarray,
    ray: int,
    places: np.ndarray,
    normals: np.ndarray,
    point: int,
    across: np.float32,
    limits: np.ndarray,
) -> tuple[np.float32, np.float32]:
    """How far along a ray it meets a plane, and how far from its place that is, squared."""
    x = places[point, 0] - origins[ray, 0]
    y = places[point, 1] - origins[ray, 1]
    z = places[point, 2] - origins[ray, 2]
    depth = x * directions[ray, 0] + y * directions[ray, 1] + z * directions[ray, 2]
    distance = depth
    if across < -limits[0]:
        height = x * normals[point, 0] + y * normals[point, 1] + z * normals[point, 2]
        distance = height / min(across, -limits[1])
        distance = min(max(distance, depth - limits[2]), depth + limits[2])
    x = distance * directions[ray, 0] - x
    y = distance * directions[ray, 1] - y
    z = distance * directions[ray, 2] - z
    return distance, x * x + y * y + z * z


@numba.njit(cache=True, inline="always")
def _nearness(squared: np.float32, width: np.float32) -> np.float32:
    part = 1 / (1 + squared / (width * width))
    return part * part


@numba.njit(cache=True, inline="always")
def _squared(first: np.ndarray, one: int, second: np.ndarray, other: int) -> np.float32:
    """Squared distance of two rows."""
    x = first[one, 0] - second[other, 0]
    y = first[one, 1] - second[other, 1]
    z = first[one, 2] - second[other, 2]
    return x * x + y * y + z * z


@numba.njit(cache=True, inline="always")
def _dot(first: np.ndarray, one: int, second: np.ndarray, other: int) -> np.float32:
    """Scalar product of two rows."""
    x = first[one, 0] * second[other, 0]
    return x + first[one, 1] * second[other, 1] + first[one, 2] * second[other, 2]

"""Where rays meet the planes over their points, and the light there, on the CPU: a pass per ray."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from pcore.kernels.numba_bridge import as_float32, use_torch_threads


@dataclass(frozen=True, kw_only=True)
class Planes:
    """What N planes are to the kernel; all on the CPU.

    Attributes:
        places: (N, 3) world units.
        normals: (N, 3) unit, or zero.
        changes: (N,) logarithms of factors.
        beside: (N, K) int64 planes around each.
    """

    places: Tensor
    normals: Tensor
    changes: Tensor
    beside: Tensor


def meet(
    planes: Planes,
    origins: Tensor,
    directions: Tensor,
    weights: Tensor,
    points: Tensor,
    limits: tuple[float, ...],
) -> tuple[Tensor, Tensor]:
    """Places (M, 3) where rays meet planes and factors (M,) there; see `pcore.model.meeting`.

    Args:
        planes: what is met.
        origins: (M, 3) of the rays, world units.
        directions: (M, 3) unit.
        weights: (M, k) of planes, not all zero.
        points: (M, k) which those are.
        limits: least cosine of facing, that of slanting, how far before and behind its place a
            plane is met, how far from it it counts where a ray is met and where light is, world
            units, and the weight of what faces away.
    """
    use_torch_threads()
    found, factors = torch.empty(len(origins), 3), torch.empty(len(origins))
    _meet(
        as_float32(planes.places),
        as_float32(planes.normals),
        as_float32(planes.changes),
        planes.beside.contiguous().numpy(),
        as_float32(origins),
        as_float32(directions),
        as_float32(weights),
        points.contiguous().numpy(),
        np.array(limits, dtype=np.float32),
        found.numpy(),
        factors.numpy(),
    )
    return found, factors


@numba.njit(cache=True, parallel=True)
def _meet(
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
        origin, ahead = origins[ray], directions[ray]
        shown = np.float32(0)
        for slot in range(points.shape[1]):
            if _dot(normals[points[ray, slot]], ahead) < -facing:
                shown += weights[ray, slot]
        total, mean = np.float32(0), np.float32(0)
        most, middle = np.float32(-1), points[ray, 0]
        for slot in range(points.shape[1]):
            point, share = points[ray, slot], weights[ray, slot]
            across = _dot(normals[point], ahead)
            if shown > hidden and across >= -facing:
                share = np.float32(0)
            distance, apart = _plane(origin, ahead, places[point], normals[point], across, limits)
            share *= _nearness(apart, limits[3])
            total += share
            mean += share * distance
            if share > most:
                most, middle = share, point
        mean /= total
        for axis in range(3):
            found[ray, axis] = origin[axis] + mean * ahead[axis]
        if beside.shape[1] > 0:
            around = beside[middle]
            factors[ray] = _factor(found[ray], ahead, places, normals, changes, around, limits)
        else:
            factors[ray] = 1


@numba.njit(cache=True)
def _factor(
    place: np.ndarray,
    ahead: np.ndarray,
    places: np.ndarray,
    normals: np.ndarray,
    changes: np.ndarray,
    around: np.ndarray,
    limits: np.ndarray,
) -> float:
    """Mean factor of the planes around a place that face a ray."""
    change, total = np.float32(0), np.float32(0)
    for piece in around:
        apart = np.float32(0)
        for axis in range(3):
            apart += (places[piece, axis] - place[axis]) ** 2
        share = _nearness(apart, limits[4])
        if -_dot(normals[piece], ahead) <= limits[0]:
            share *= limits[5]
        total += share
        change += share * changes[piece]
    return math.exp(change / total)


@numba.njit(cache=True, inline="always")
def _plane(
    origin: np.ndarray,
    ahead: np.ndarray,
    place: np.ndarray,
    normal: np.ndarray,
    across: np.float32,
    limits: np.ndarray,
) -> tuple[np.float32, np.float32]:
    """How far along a ray it meets a plane, and how far from its place that is, squared."""
    x, y, z = place[0] - origin[0], place[1] - origin[1], place[2] - origin[2]
    depth = x * ahead[0] + y * ahead[1] + z * ahead[2]
    distance = depth
    if across < -limits[0]:
        distance = (x * normal[0] + y * normal[1] + z * normal[2]) / min(across, -limits[1])
        distance = min(max(distance, depth - limits[2]), depth + limits[2])
    x, y, z = distance * ahead[0] - x, distance * ahead[1] - y, distance * ahead[2] - z
    return distance, x * x + y * y + z * z


@numba.njit(cache=True, inline="always")
def _nearness(squared: np.float32, width: np.float32) -> np.float32:
    part = 1 / (1 + squared / (width * width))
    return part * part


@numba.njit(cache=True, inline="always")
def _dot(first: np.ndarray, second: np.ndarray) -> np.float32:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]

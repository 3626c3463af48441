"""Nearest-to-ray search on the CPU: bundles of rays, and what no ray of a bundle can be near to.

Rays are split into ever smaller bundles of lines that run close together (`line_bundles`). A bundle
has an axis and, at axial position z, a spread r(z): no line of it passes farther than r(z) from the
axis there. A point at z and at distance h from the axis therefore lies

    between (h - r(z)) cos a and h + r(z)

from every line of the bundle, with a the largest angle between a line and the axis. When k points
have upper bounds of at most T, points with lower bounds above T are no ray's neighbours: they are
dropped for the whole bundle, and its parts only look at the rest. What is left for the last bundles
is ranked ray by ray with the very arithmetic of the specification, so the result is exact. Lines
need not meet in a camera, and the order in which rays are given does not matter.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.line_bundles import LEAF, as_lines, cut, enclose, split
from pcore.kernels.numba_bridge import as_float32
from pcore.kernels.sorted_keys import PLACE, key_of, sift

_SHRINK = 3
"""A bundle is examined when it has at most 1 / _SHRINK of the rays of the last one examined: in
between, points would be looked at more often than dropped."""
_WORTH = 0.7
"""A shorter list of points is made when it has at most this part of the longer one; all lists on
the way down to a leaf then fit into 1 / (1 - _WORTH) times the cloud."""
_LANES = 8
"""The k-th upper bound is looked for among _LANES k minima, of strided subsets."""
_HALVINGS = 10
"""How often the interval around that bound is halved."""
_STRIP = 32
"""Points that are compared at once with the farthest neighbour so far."""


def nearest_to_rays(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Indices (R, k) of the points with the smallest distance to the lines of (R, 3) rays."""
    workers = use_torch_threads()
    columns = np.ascontiguousarray(as_float32(points).T)
    out = search(as_float32(origins), as_float32(directions), columns, k, workers)
    return torch.from_numpy(out)


def search(
    origins: np.ndarray, directions: np.ndarray, points: np.ndarray, k: int, workers: int
) -> np.ndarray:
    """Indices (R, k) for (R, 3) origins and directions and (3, N) points.

    Workers are Python threads around compiled code without the interpreter's lock: numba's own
    parallel loops would take ten more seconds to compile.
    """
    out = np.empty((len(origins), k), dtype=np.int64)
    box = np.stack([points.min(axis=1), points.max(axis=1)])
    lines, centre, radius, margin = as_lines(origins, directions, box)
    order = np.arange(len(origins))
    # One worker starts with all rays, several share out many parts.
    borders = cut(lines, order, radius, 1 if workers == 1 else 8 * workers)
    rays, cloud = (origins, directions, lines, order), (points, centre, radius, margin)

    def work(start: int, stop: int) -> None:
        _descend(rays, cloud, start, stop, out)

    if workers == 1:
        work(0, len(origins))
        return out
    with ThreadPoolExecutor(workers) as threads:
        list(threads.map(work, borders[:-1], borders[1:]))
    return out


@numba.njit(cache=True, nogil=True)
def _descend(rays: Any, cloud: Any, start: int, stop: int, out: np.ndarray) -> None:
    """Split a bundle down to leaves; drop points on the way, rank what is left at the leaves.

    Lists of points lie on one stack: whoever is on the way down from a bundle only writes above
    that bundle's list.
    """
    origins, directions, lines, order = rays
    points, centre, radius, margin = cloud
    count, k = points.shape[1], out.shape[1]
    room = int(count / (1.0 - _WORTH)) + 1
    listed = np.empty(room, dtype=np.int32)
    near = np.empty((3, room), dtype=np.float32)
    for i in range(count):
        listed[i] = i
        near[0, i], near[1, i], near[2, i] = points[0, i], points[1, i], points[2, i]
    scratch = np.empty((3, count), dtype=np.float32)
    # Rays from and to, points from and how many, rays when points were last dropped. Bundles that
    # wait share no rays, so there are never more than rays.
    todo, waiting = np.empty((stop - start + 1, 5), dtype=np.int64), 1
    todo[0] = (start, stop, 0, count, stop - start + _SHRINK * LEAF)
    while waiting > 0:
        waiting -= 1
        start, stop, first, size, examined = todo[waiting]
        n = stop - start
        due = n > 1 and (n <= LEAF or n * _SHRINK <= examined)
        if due and size > 2 * k and margin < np.inf:
            examined = n
            tube = enclose(lines[start:stop], centre, radius)
            kept = _drop(near, listed, first, size, tube, margin, k, scratch)
            if kept < size:
                first, size = first + size, kept
        if n > LEAF:
            border = split(lines, order, radius, start, stop)
            todo[waiting] = (border, stop, first, size, examined)
            todo[waiting + 1] = (start, border, first, size, examined)
            waiting += 2
            continue
        part = slice(first, first + size)
        places = (near[0, part], near[1, part], near[2, part])
        _rank(origins, directions, order[start:stop], places, listed[part], scratch[0], out)


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _drop(
    near: np.ndarray,
    listed: np.ndarray,
    first: int,
    size: int,
    tube: Any,
    margin: float,
    k: int,
    scratch: np.ndarray,
) -> int:
    """List behind the list at `first` those of its points that may be neighbours.

    Returns:
        How many; `size` where it is not worth a new list.
    """
    if tube.cosine == 0:
        return size
    lower, upper, least = scratch[0], scratch[1], scratch[2]
    _bound(near[0, first:], near[1, first:], near[2, first:], size, tube, lower, upper)
    lanes = _LANES * k if size >= 2 * _LANES * k else size
    for lane in range(lanes):
        least[lane] = upper[lane]
    for begin in range(lanes, size, lanes):
        for lane in range(min(lanes, size - begin)):
            least[lane] = min(least[lane], upper[begin + lane])
    # What rounding may have done to either of the distances that are compared.
    bound = (_kth(least[:lanes], k) + np.float32(2.0) * margin) / tube.cosine
    picked, kept = upper.view(np.int32), 0
    for i in range(size):
        picked[kept] = i
        kept += lower[i] <= bound
    if kept > _WORTH * size:
        return size
    for i in range(kept):
        at, to = first + picked[i], first + size + i
        listed[to] = listed[at]
        near[0, to], near[1, to], near[2, to] = near[0, at], near[1, at], near[2, at]
    return kept


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _bound(
    px: np.ndarray,
    py: np.ndarray,
    pz: np.ndarray,
    size: int,
    tube: Any,
    lower: np.ndarray,
    upper: np.ndarray,
) -> None:
    """Bounds of the distances of points to the lines in a tube; the lower one over its cosine."""
    cx, cy, cz = tube.foot[0], tube.foot[1], tube.foot[2]
    ax, ay, az = tube.axis[0], tube.axis[1], tube.axis[2]
    for i in range(size):
        vx, vy, vz = px[i] - cx, py[i] - cy, pz[i] - cz
        z = vx * ax + vy * ay + vz * az
        # The difference form, as for the distances themselves.
        tx, ty, tz = vx - z * ax, vy - z * ay, vz - z * az
        h = np.sqrt(tx * tx + ty * ty + tz * tz)
        r = max(tube.base + tube.slope * z, tube.base_after + tube.slope_after * z)
        lower[i], upper[i] = h - r, h + r


@numba.njit(cache=True, fastmath=True, error_model="numpy")
def _kth(values: np.ndarray, k: int) -> Any:
    """Return a number that at least k of the values do not exceed, close to the k-th of them."""
    low, high = values[0], values[0]
    for i in range(values.shape[0]):
        low, high = min(low, values[i]), max(high, values[i])
    for _ in range(_HALVINGS):
        middle, below = np.float32(0.5) * (low + high), 0
        for i in range(values.shape[0]):
            below += values[i] <= middle
        if below >= k:
            high = middle
        else:
            low = middle
    return high


@numba.njit(cache=True, error_model="numpy")
def _measure(
    origin: np.ndarray, direction: np.ndarray, places: Any, squared: np.ndarray, size: int
) -> None:
    """Squared distances of points to a line, operation by operation as in the specification."""
    px, py, pz = places
    ox, oy, oz = origin[0], origin[1], origin[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    for i in range(size):
        vx, vy, vz = px[i] - ox, py[i] - oy, pz[i] - oz
        along = vx * dx + vy * dy + vz * dz
        tx, ty, tz = vx - along * dx, vy - along * dy, vz - along * dz
        squared[i] = tx * tx + ty * ty + tz * tz


@numba.njit(cache=True)
def _rank(
    origins: np.ndarray,
    directions: np.ndarray,
    bundle: np.ndarray,
    places: Any,
    listed: np.ndarray,
    squared: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the k nearest of the listed points for every ray of a bundle.

    A ray starts from the neighbours of the ray before: few of them move, and hardly any is new.
    """
    size, k = listed.shape[0], out.shape[1]
    mask = np.int32(0x7FFFFFFF)
    bits, best = squared.view(np.int32), np.arange(k)
    for ray in bundle:
        _measure(origins[ray], directions[ray], places, squared, size)
        for slot in range(k):
            place = best[slot] & PLACE
            sift(best, slot, key_of(bits[place], place))
            bits[place] = mask
        farthest = np.int32(best[k - 1] >> 32)
        for begin in range(0, size, _STRIP):
            end, hits = min(size, begin + _STRIP), 0
            for i in range(begin, end):
                hits += (bits[i] & mask) <= farthest
            for i in range(begin, end if hits > 0 else begin):
                key = key_of(bits[i], i)
                if key < best[k - 1]:
                    sift(best, k - 1, key)
                    farthest = np.int32(best[k - 1] >> 32)
        for slot in range(k):
            out[ray, slot] = listed[best[slot] & PLACE]

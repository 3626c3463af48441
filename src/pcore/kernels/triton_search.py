"""Nearest-to-ray search on a GPU by Triton: dense distances that never leave the chip.

A program looks at all points for a few neighbouring rays, twice. The first time it keeps the least
distance of each of many strided subsets of the points: the k-th least of these bounds the k-th
distance from above, tightly. The second time it merges the few points within the bound into a
sorted list. Without the bound most of the time would go into merging points that do not stay.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

RAYS, LANES = 16, 128
"""Rays of a program; points that it looks at side by side."""
_LEAST_SLOTS = 16


def nearest_to_rays(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Indices (R, k) of the points with the smallest distance to the lines of (R, 3) rays."""
    origins, directions, points = (
        x.detach().float().contiguous() for x in (origins, directions, points)
    )
    out = torch.empty(len(origins), k, dtype=torch.int64, device=points.device)
    if len(origins) > 0:
        slots, lanes = sizes(k)
        arguments = (origins, directions, points, out, len(origins), len(points), k)
        grid = (triton.cdiv(len(origins), RAYS),)
        # Fused operations would round differently from the specification.
        search[grid](*arguments, RAYS, lanes, slots, enable_fp_fusion=False)
    return out


def sizes(k: int) -> tuple[int, int]:
    """Length of the sorted list and number of subsets for k neighbours, both powers of two."""
    slots = max(_LEAST_SLOTS, triton.next_power_of_2(k))
    return slots, max(LANES, 4 * slots)


@triton.jit
def _squared(ox, oy, oz, dx, dy, dz, points, count, at):
    """Squared distances (rays, lanes) to the points at `at`; infinite beyond the last of them."""
    inside = at < count
    px = tl.load(points + 3 * at, mask=inside, other=0.0)[None, :]
    py = tl.load(points + 3 * at + 1, mask=inside, other=0.0)[None, :]
    pz = tl.load(points + 3 * at + 2, mask=inside, other=0.0)[None, :]
    vx, vy, vz = px - ox, py - oy, pz - oz
    along = vx * dx + vy * dy + vz * dz
    tx, ty, tz = vx - along * dx, vy - along * dy, vz - along * dz
    squared = tx * tx + ty * ty + tz * tz
    # A point that is no number is as far as can be, so that there are always k.
    return tl.where(inside[None, :] & (squared == squared), squared, float("inf"))


@triton.jit
def search(
    origins,
    directions,
    points,
    out,
    rays,
    count,
    k,
    RAYS: tl.constexpr,
    LANES: tl.constexpr,
    SLOTS: tl.constexpr,
):
    """Write the indices (rays, k) of the nearest of `count` points."""
    ray = tl.program_id(0) * RAYS + tl.arange(0, RAYS)
    real = ray < rays
    ox = tl.load(origins + 3 * ray, mask=real, other=0.0)[:, None]
    oy = tl.load(origins + 3 * ray + 1, mask=real, other=0.0)[:, None]
    oz = tl.load(origins + 3 * ray + 2, mask=real, other=0.0)[:, None]
    dx = tl.load(directions + 3 * ray, mask=real, other=0.0)[:, None]
    dy = tl.load(directions + 3 * ray + 1, mask=real, other=0.0)[:, None]
    dz = tl.load(directions + 3 * ray + 2, mask=real, other=0.0)[:, None]

    least = tl.full((RAYS, LANES), float("inf"), tl.float32)
    for start in range(0, count, LANES):
        at = start + tl.arange(0, LANES)
        least = tl.minimum(least, _squared(ox, oy, oz, dx, dy, dz, points, count, at))
    ordered = tl.sort(least)
    chosen = tl.arange(0, LANES)[None, :] == k - 1
    bound = tl.sum(tl.where(chosen, ordered, 0.0), axis=1)[:, None]

    # A key is the squared distance, whose bits are ordered as integers, and behind it the index.
    best = tl.full((RAYS, SLOTS), 0x7FFFFFFFFFFFFFFF, tl.int64)
    for start in range(0, count, LANES):
        at = start + tl.arange(0, LANES)
        near = _squared(ox, oy, oz, dx, dy, dz, points, count, at) <= bound
        near = near & (at < count)[None, :]
        if tl.max(near.to(tl.int32)) > 0:
            for part in range(start, start + LANES, SLOTS):
                at_part = part + tl.arange(0, SLOTS)
                squared = _squared(ox, oy, oz, dx, dy, dz, points, count, at_part)
                key = (squared.to(tl.int32, bitcast=True).to(tl.int64) << 32) | at_part[None, :]
                key = tl.where((at_part < count)[None, :], key, 0x7FFFFFFFFFFFFFFF)
                # An ascending and a descending list: their minima are the least of both.
                best = tl.sort(tl.minimum(best, tl.sort(key, descending=True)))
    slot = tl.arange(0, SLOTS)
    target = out + k * ray[:, None] + slot[None, :]
    tl.store(target, best & 0xFFFFFFFF, mask=real[:, None] & (slot < k)[None, :])

"""Public face of the kernels: one signature each, the backend chosen by device."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.kernels import cpu, cpu_search, reference

BACKENDS = ("reference", "cpu", "triton")


def backend(device: torch.device) -> str:
    """Name of the backend that the kernels use on a device.

    PCORE_KERNELS=reference|cpu|triton overrides the choice.

    Raises:
        InputError: the variable names no backend, or one that cannot work on the device.
    """
    wanted = os.environ.get("PCORE_KERNELS")
    if wanted is None:
        return usable(device)[-1]
    if wanted not in BACKENDS:
        raise InputError(f"PCORE_KERNELS: expected one of {', '.join(BACKENDS)}, got {wanted!r}")
    if wanted not in usable(device):
        raise InputError(
            f"PCORE_KERNELS: expected one of {', '.join(usable(device))} for tensors on "
            f"{device.type}, got {wanted!r}; unset it, or see what `pcore doctor` says"
        )
    return wanted


def usable(device: torch.device) -> tuple[str, ...]:
    """Backends that can work on a device, the best last."""
    if device.type == "cpu":
        return ("reference", "cpu")
    return ("reference", "triton") if device.type == "cuda" and has_triton() else ("reference",)


@cache
def has_triton() -> bool:
    """Whether Triton can be imported; torch for CUDA brings it along on Linux."""
    return find_spec("triton") is not None


def nearest_to_rays(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Indices of the k points nearest to each ray's infinite line, nearest first.

    Args:
        origins: (..., 3) ray origins.
        directions: (..., 3) unit directions.
        points: (N, 3).
        k: how many; N when there are fewer points.

    Returns:
        (..., min(k, N)) int64 indices; equal distances come in order of the index.

    Raises:
        InputError: without points, or with k < 1.
    """
    if points.shape[0] == 0 or k < 1:
        raise InputError(
            f"nearest_to_rays: expected at least one point and k >= 1, got {points.shape[0]} "
            f"points and k = {k}"
        )
    k = min(k, points.shape[0])
    search = _search(backend(points.device))
    flat = search(origins.reshape(-1, 3), directions.reshape(-1, 3), points, k)
    return flat.reshape(*origins.shape[:-1], k)


def _search(name: str) -> Callable[[Tensor, Tensor, Tensor, int], Tensor]:
    if name == "triton":
        # Triton is no dependency: it is looked for where it is used.
        from pcore.kernels import triton_search

        return triton_search.nearest_to_rays
    return cpu_search.nearest_to_rays if name == "cpu" else reference.nearest_to_rays


def encode_pairs(
    positions: Tensor,
    features: Tensor,
    origins: Tensor,
    directions: Tensor,
    neighbours: Tensor,
    *,
    scale: float,
    frequencies: int,
) -> tuple[Tensor, Tensor]:
    """What PAPR's embedding networks see of every ray-point pair.

    With h the part of (point - origin) along the ray and t the rest (paper, Preliminaries), a row
    is [gamma(scale p), gamma(scale h), gamma(scale t), mu]: the key reads the first three blocks,
    the value the last three. No gradient flows through gamma(scale p), as in the original.

    Args:
        positions: (N, 3).
        features: (N, F).
        origins: (R, 3) ray origins, or (R, k, 3) one per pair; not differentiated.
        directions: unit directions of the same shape; not differentiated.
        neighbours: (R, k) indices into the points.
        scale: factor on positions before they are encoded.
        frequencies: octaves L of the encoding.

    Returns:
        The table (R k, 9 (1 + 2 L) + F), differentiable in positions and features, and the squared
        distances |t|^2 (R, k), without gradient.
    """
    if backend(positions.device) == "cpu" and positions.dtype == torch.float32:
        encode = cpu.encode_pairs
    else:
        encode = reference.encode_pairs
    return encode(
        positions,
        features,
        origins.detach(),
        directions.detach(),
        neighbours,
        scale=scale,
        frequencies=frequencies,
    )


def pull_back(
    origins: Tensor,
    directions: Tensor,
    positions: Tensor,
    rest: Tensor,
    to_rest: Tensor,
    candidates: Tensor,
    k: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Choose the k candidates nearest to a ray in the rest state, and the ray as each sees it.

    With B the inverse of the map around a point, the ray (o, d) is the ray p + B (o - p'),
    B d / |B d| of the rest state. Nothing is differentiated.

    Args:
        origins: (R, 3) ray origins in the deformed state.
        directions: (R, 3) unit directions.
        positions: (N, 3) deformed points p'.
        rest: (N, 3) points p of the rest state.
        to_rest: (N, 3, 3) the maps B.
        candidates: (R, c) indices into the points, c >= k.
        k: how many to keep.

    Returns:
        Indices (R, k), nearest first in the rest state; origins (R, k, 3) and unit directions
        (R, k, 3) of the rays of the rest state.
    """
    single = positions.dtype == torch.float32
    work = cpu if single and backend(positions.device) == "cpu" else reference
    with torch.no_grad():
        return work.pull_back(origins, directions, positions, rest, to_rest, candidates, k)

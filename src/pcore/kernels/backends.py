"""Which backend serves what, and what each of them takes."""

from __future__ import annotations

import os
from functools import cache
from importlib.util import find_spec

import torch
from torch import Tensor

from pcore.errors import DependencyError, InputError
from pcore.kernels.networks import Layers

BACKENDS = ("reference", "cpu", "triton")
LARGEST_WIDTH, MOST_NEIGHBOURS = 256, 128
"""Attention by Triton takes networks and rays up to these: more does not fit a program."""
MOST_FOUND = 64
"""The search by Triton finds so many: longer sorted lists do not fit a program."""


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


@cache
def has_gsplat() -> bool:
    """Whether gsplat can be imported, which draws Gaussians on a GPU."""
    return find_spec("gsplat") is not None


def takes_cpu(tensor: Tensor) -> bool:
    """Whether the CPU kernels serve a tensor: they know float32 and no autocast."""
    return (
        backend(tensor.device) == "cpu"
        and tensor.dtype == torch.float32
        and not torch.is_autocast_enabled(tensor.device.type)
    )


def of_search(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> str:
    """Name of the backend that serves a search; `reference` serves what the others do not.

    The others compute in float32: float64 would be rounded, and half precision picks wrong points.
    """
    name = backend(points.device)
    single = all(one.dtype == torch.float32 for one in (origins, directions, points))
    if not single or (name == "triton" and k > MOST_FOUND):
        return "reference"
    return name


def of_attention(positions: Tensor, key: Layers, value: Layers, neighbours: int) -> str:
    """Name of the backend that serves an attention; `reference` serves what the others do not.

    The CPU kernels take float32 without autocast. Triton takes float32, with autocast or without,
    layers of up to `LARGEST_WIDTH` and up to `MOST_NEIGHBOURS` neighbours of a ray: all presets.
    """
    if takes_cpu(positions):
        return "cpu"
    if backend(positions.device) != "triton" or positions.dtype != torch.float32:
        return "reference"
    # The value network's last layer is applied once per ray, outside.
    widest = max(len(bias) for bias in (*key.biases, *value.biases[:-1]))
    fits = widest <= LARGEST_WIDTH and neighbours <= MOST_NEIGHBOURS
    return "triton" if fits else "reference"


def of_gaussians(means: Tensor) -> str:
    """Name of the backend that draws Gaussians: "cpu", "gsplat" or "reference".

    The CPU kernels take float32 and float64. On a GPU everything is drawn by gsplat, which knows
    float32 alone, unless PCORE_KERNELS=reference asks for the dense formulas.

    Raises:
        DependencyError: on a GPU without gsplat.
    """
    name = backend(means.device)
    if means.device.type == "cpu":
        exact = means.dtype in (torch.float32, torch.float64)
        return "cpu" if name == "cpu" and exact else "reference"
    if os.environ.get("PCORE_KERNELS") == "reference":
        return "reference"
    if not has_gsplat():
        raise DependencyError(
            "Gaussians on a GPU need gsplat, which is not installed; install it with: pip install "
            "'pcore-edit[gsplat]' (its first call compiles CUDA code with nvcc, whose version must "
            "be that of torch), or draw on the CPU: --device cpu"
        )
    return "gsplat"


def of_discs(means: Tensor) -> str:
    """Name of the backend that draws flat Gaussians: "cpu" or "reference".

    Raises:
        DependencyError: on a GPU, where nothing of ours draws them and gsplat's kernels have
            neither tangents nor a filter of a pixel's size.
    """
    if means.device.type != "cpu" and os.environ.get("PCORE_KERNELS") != "reference":
        raise DependencyError(
            "flat Gaussians (2DGS) are drawn on the CPU: pass --device cpu, or leave out --flat"
        )
    return "reference" if means.device.type != "cpu" else of_gaussians(means)

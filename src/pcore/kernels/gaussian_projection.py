"""Gaussians in space to Gaussians in the picture on the CPU, with gradients.

`reference_gaussians` says the same by products of matrices, `cpu_projection_loops` how.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.geometry.torch_threads import use_torch_threads
from pcore.kernels.cpu_projection_gradients import project_backward
from pcore.kernels.cpu_projection_loops import CHUNK
from pcore.kernels.cpu_projection_loops import project as fill_projected
from pcore.kernels.numba_bridge import as_array


@dataclass(frozen=True, kw_only=True)
class Projected:
    """N Gaussians before C cameras; only those in front of the near plane mean anything.

    Attributes:
        means: (C, N, 2) columns and rows of the centres, pixels.
        depths: (C, N) camera z of the centres, world units.
        conics: (C, N, 3) inverse of the 2 x 2 covariances: xx, xy, yy, 1 / pixels squared.
        shares: (C, N) what the screen filter leaves of the opacities when the Gaussians' sums are
            to stay (antialiased); between 0 and 1.
    """

    means: Tensor
    depths: Tensor
    conics: Tensor
    shares: Tensor


def project(
    means: Tensor,
    covariances: Tensor,
    viewmats: Tensor,
    intrinsics: Tensor,
    size: tuple[int, int],
    *,
    near_plane: float,
    eps2d: float,
) -> Projected:
    """Project by the pinhole's derivative at the centres (Zwicker et al. 2001).

    Args:
        means: (N, 3) world units.
        covariances: (N, 6) entries xx, xy, xz, yy, yz, zz, world units squared.
        viewmats: (C, 4, 4) camera from world, OpenCV axes (z forward).
        intrinsics: (C, 3, 3) without skew, pixels.
        size: width and height, pixels.
        near_plane: depths below it are taken for this one, so that nothing is divided by zero.
        eps2d: variance of the screen filter, pixels squared.
    """
    screen = (float(size[0]), float(size[1]), near_plane, eps2d)
    given = (one.to(means.dtype) for one in (covariances, viewmats, intrinsics))
    means2d, depths, conics, shares = _Projection.apply(means, *given, screen)
    return Projected(means=means2d, depths=depths, conics=conics, shares=shares)


def covariances_of(quats: Tensor, scales: Tensor) -> Tensor:
    """Entries xx, xy, xz, yy, yz, zz (N, 6) of R S S R^T.

    Args:
        quats: (N, 4) w x y z, of any length but zero.
        scales: (N, 3) standard deviations.
    """
    return _Covariances.apply(quats, scales)


def entries_of(covars: Tensor) -> Tensor:
    """Entries xx, xy, xz, yy, yz, zz (N, 6) of the symmetric part of matrices (N, 3, 3)."""
    # Both triangles get gradient, as a symmetric matrix's must.
    return ((covars + covars.mT) / 2).flatten(-2)[..., _UPPER]


_UPPER = [0, 1, 2, 4, 5, 8]


class _Covariances(torch.autograd.Function):
    """Entries xx, xy, xz, yy, yz, zz (N, 6) of R S S R^T, from quats (N, 4) and scales (N, 3)."""

    @staticmethod
    def forward(ctx: Any, quats: Tensor, scales: Tensor) -> Tensor:
        use_torch_threads()
        found = quats.new_empty(len(quats), 6)
        covariances(as_array(quats), as_array(scales), found.numpy())
        ctx.save_for_backward(quats, scales)
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:  # pyright: ignore
        use_torch_threads()
        quats, scales = ctx.saved_tensors
        to_quats = quats.new_empty(quats.shape)
        to_scales = scales.new_empty(scales.shape)
        covariances_backward(
            as_array(quats),
            as_array(scales),
            as_array(gradients[0]),
            (to_quats.numpy(), to_scales.numpy()),
        )
        return to_quats, to_scales


class _Projection(torch.autograd.Function):
    """Places in the picture, depths, conics and shares; see `project`.

    Inputs: means (N, 3), covariances (N, 6), viewmats (C, 4, 4), intrinsics (C, 3, 3), all of one
    type, and how the screen is: width, height, near plane, variance of the filter.
    """

    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        covariances: Tensor,
        viewmats: Tensor,
        intrinsics: Tensor,
        screen: tuple[float, float, float, float],
    ) -> tuple[Tensor, ...]:
        use_torch_threads()
        count = len(viewmats), len(means)
        found = tuple(means.new_empty(*count, *rest) for rest in ((2,), (), (3,), ()))
        fill_projected(
            (as_array(means), as_array(covariances)),
            (as_array(viewmats), as_array(intrinsics)),
            screen,
            tuple(one.numpy() for one in found),
        )
        ctx.save_for_backward(means, covariances, viewmats, intrinsics)
        ctx.screen = screen
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        use_torch_threads()
        means, covariances, viewmats, intrinsics = ctx.saved_tensors
        to_means, to_covariances = means.new_empty(means.shape), means.new_empty(covariances.shape)
        chunks = (len(means) + CHUNK - 1) // CHUNK
        to_cameras = np.zeros((chunks, len(viewmats), 4, 4))
        to_lenses = np.zeros((chunks, len(viewmats), 3, 3))
        project_backward(
            (as_array(means), as_array(covariances)),
            (as_array(viewmats), as_array(intrinsics)),
            ctx.screen,
            tuple(as_array(one) for one in gradients),
            (to_means.numpy(), to_covariances.numpy(), to_cameras, to_lenses),
        )
        cameras, lenses = (
            torch.from_numpy(one.sum(axis=0)).to(means) for one in (to_cameras, to_lenses)
        )
        return to_means, to_covariances, cameras, lenses, None


@numba.njit(cache=True, error_model="numpy")
def _rotation(quat: np.ndarray, turn: np.ndarray) -> float:
    """Fill in the rotation (3, 3) of a quaternion w x y z; return the quaternion's length."""
    length = math.sqrt(
        float(quat[0]) ** 2 + float(quat[1]) ** 2 + float(quat[2]) ** 2 + float(quat[3]) ** 2
    )
    w, x, y, z = quat[0] / length, quat[1] / length, quat[2] / length, quat[3] / length
    turn[0, 0], turn[0, 1], turn[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
    )
    turn[1, 0], turn[1, 1], turn[1, 2] = (
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
    )
    turn[2, 0], turn[2, 1], turn[2, 2] = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )
    return length


@numba.njit(cache=True, parallel=True, error_model="numpy")
def covariances(quats: np.ndarray, scales: np.ndarray, found: np.ndarray) -> None:
    """Fill in the entries xx, xy, xz, yy, yz, zz (N, 6) from quats (N, 4) and scales (N, 3)."""
    for chunk in prange((len(quats) + CHUNK - 1) // CHUNK):
        root = np.empty((3, 3))
        for n in range(chunk * CHUNK, min(len(quats), (chunk + 1) * CHUNK)):
            _rotation(quats[n], root)
            for j in range(3):
                for i in range(3):
                    root[i, j] *= scales[n, j]
            entry = 0
            for i in range(3):
                for j in range(i, 3):
                    found[n, entry] = (
                        root[i, 0] * root[j, 0] + root[i, 1] * root[j, 1] + root[i, 2] * root[j, 2]
                    )
                    entry += 1


@numba.njit(cache=True, parallel=True, error_model="numpy")
def covariances_backward(
    quats: np.ndarray,
    scales: np.ndarray,
    gradient: np.ndarray,
    results: tuple[np.ndarray, np.ndarray],
) -> None:
    """Fill in the gradients by quats and scales from that (N, 6) by the entries."""
    to_quats, to_scales = results
    for chunk in prange((len(quats) + CHUNK - 1) // CHUNK):
        turn, t = np.empty((3, 3)), np.empty((3, 3))
        for n in range(chunk * CHUNK, min(len(quats), (chunk + 1) * CHUNK)):
            length = _rotation(quats[n], turn)
            # Twice the gradient by a symmetric matrix, whose entries beside the diagonal are two.
            xx, yy, zz = 2.0 * gradient[n, 0], 2.0 * gradient[n, 3], 2.0 * gradient[n, 5]
            xy, xz, yz = float(gradient[n, 1]), float(gradient[n, 2]), float(gradient[n, 4])
            for j in range(3):
                a, b, c = turn[0, j], turn[1, j], turn[2, j]
                scale = float(scales[n, j])
                u, v, w = (
                    xx * a + xy * b + xz * c,
                    xy * a + yy * b + yz * c,
                    xz * a + yz * b + zz * c,
                )
                to_scales[n, j] = scale * (a * u + b * v + c * w)
                square = scale * scale
                t[0, j], t[1, j], t[2, j] = square * u, square * v, square * w
            w, x = quats[n, 0] / length, quats[n, 1] / length
            y, z = quats[n, 2] / length, quats[n, 3] / length
            dw = 2 * (x * (t[2, 1] - t[1, 2]) + y * (t[0, 2] - t[2, 0]) + z * (t[1, 0] - t[0, 1]))
            dx = 2 * (
                y * (t[0, 1] + t[1, 0])
                + z * (t[0, 2] + t[2, 0])
                + w * (t[2, 1] - t[1, 2])
                - 2 * x * (t[1, 1] + t[2, 2])
            )
            dy = 2 * (
                x * (t[0, 1] + t[1, 0])
                + z * (t[1, 2] + t[2, 1])
                + w * (t[0, 2] - t[2, 0])
                - 2 * y * (t[0, 0] + t[2, 2])
            )
            dz = 2 * (
                x * (t[0, 2] + t[2, 0])
                + y * (t[1, 2] + t[2, 1])
                + w * (t[1, 0] - t[0, 1])
                - 2 * z * (t[0, 0] + t[1, 1])
            )
            along = dw * w + dx * x + dy * y + dz * z
            to_quats[n, 0], to_quats[n, 1] = (dw - along * w) / length, (dx - along * x) / length
            to_quats[n, 2], to_quats[n, 3] = (dy - along * y) / length, (dz - along * z) / length

"""Gaussians carried along by a map of space, each by the affine map nearest to it at its mean.

Near mean m the map is x' = m' + J (x - m). A Gaussian of covariance S becomes one of covariance
J S J^T around m', and what was seen of it along d is seen along Q d, where Q is the orthogonal
factor of the polar decomposition J = Q P.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from pcore.deform.base import Deformation
from pcore.errors import EditError
from pcore.gaussians.covariance import quaternions
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.spherical_harmonics import rotated
from pcore.geometry.matrix_tuples import polar_factors
from pcore.geometry.rotation import rotations

_SWEEPS = 12
_ORTHOGONAL = 1e-15
_CONVERGED, _SINGULAR = 1e-16, 1e-9
"""Of polar factors: squared change in the last round, and the volume from which on there is one."""
_FLATTEST = 1e-9
"""Share of the longest standard deviation that is kept where a map flattens a Gaussian."""


def carried(gaussians: Gaussians, positions: Tensor, local_maps: Tensor) -> Gaussians:
    """Gaussians moved by a map that is known at their means.

    The order of each one's axes is kept, so that the identity changes nothing but the last bits. A
    map that mirrors mirrors the colours, too. Shapes and colours are computed in float64 and have
    no gradient with respect to the maps; for that see `carried_axes`.

    Args:
        gaussians: N of them.
        positions: (N, 3) where their means go, world units.
        local_maps: (N, 3, 3) Jacobians there: `[n, i, j] = d out_i / d in_j`.

    Returns:
        The same number of Gaussians, in the types of the given ones.

    Raises:
        EditError: another number of positions or maps; NaN, infinity or a map that is zero.
    """
    _check(gaussians, positions, local_maps)
    maps = local_maps.detach().to(gaussians.means.device, torch.float64)
    axes = maps @ rotations(gaussians.quats.detach().double())
    left, sizes, _ = _singular(axes * gaussians.scales.detach().double().unsqueeze(-2))
    least = sizes.amax(dim=1, keepdim=True) * _FLATTEST
    return replace(
        gaussians,
        means=positions.to(gaussians.means),
        quats=quaternions(left).to(gaussians.quats),
        scales=torch.maximum(sizes, least).to(gaussians.scales),
        sh=gaussians.sh if gaussians.degree == 0 else rotated(gaussians.sh, polar(maps)),
    )


def deformed(gaussians: Gaussians, deformation: Deformation) -> Gaussians:
    """Gaussians moved by a map of space, evaluated in float64; see `carried`.

    Raises:
        EditError: the map is not finite, or shrinks to nothing, at some of the means.
    """
    means = gaussians.means.detach().cpu().double()
    return carried(gaussians, deformation(means), deformation.jacobian(means))


def carried_axes(gaussians: Gaussians, local_maps: Tensor) -> Tensor:
    """Axes A (N, 3, 3), its columns, after local maps (N, 3, 3): covariances are A A^T.

    Differentiable in everything. Axes are as long as standard deviations, and no longer
    perpendicular.
    """
    axes = rotations(gaussians.quats) * gaussians.scales.unsqueeze(-2)
    return local_maps.to(axes) @ axes


def polar(matrices: Tensor) -> Tensor:
    """Orthogonal factors Q (N, 3, 3) of J = Q P, P symmetric and not negative; differentiable.

    They mirror where J does. Of a singular J one of the rotations that are possible.
    """
    return _Polar.apply(matrices)  # pyright: ignore


class _Polar(torch.autograd.Function):
    """Q of J, computed in float64."""

    @staticmethod
    def forward(ctx: Any, matrices: Tensor) -> Tensor:
        found = _factors(matrices.detach().double())
        ctx.save_for_backward(matrices, found)
        return found.to(matrices)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:  # pyright: ignore
        """A change of J turns Q by w, where (tr P - P) w is the axis of Q^T dJ - (Q^T dJ)^T."""
        matrices, found = ctx.saved_tensors
        stretch = found.mT @ matrices.double()
        trace = stretch.diagonal(dim1=-2, dim2=-1).sum(dim=-1)
        change = found.mT @ gradient.double()
        axis = torch.stack([change[..., (i + 2) % 3, (i + 1) % 3] for i in range(3)], dim=-1)
        axis -= torch.stack([change[..., (i + 1) % 3, (i + 2) % 3] for i in range(3)], dim=-1)
        system = trace[..., None, None] * torch.eye(3).to(stretch) - (stretch + stretch.mT) / 2
        turn = torch.linalg.solve_ex(system, axis)[0]
        return (found @ _skew(turn)).to(gradient)


def _skew(axis: Tensor) -> Tensor:
    """Matrices (..., 3, 3) that take the cross product with axes (..., 3)."""
    x, y, z = axis.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def _factors(wide: Tensor) -> Tensor:
    """Newton's iteration where it is compiled and converges, in a tenth of the time."""
    if wide.device.type != "cpu":
        return _orthogonal(wide)
    flat = wide.reshape(-1, 9)
    found = torch.from_numpy(polar_factors(flat.numpy(), _CONVERGED)).view(wide.shape)
    volume = torch.linalg.cross(wide[..., 0], wide[..., 1]).mul(wide[..., 2]).sum(dim=-1)
    flattened = volume.abs() <= _SINGULAR * wide.square().sum(dim=(-2, -1)).pow(1.5)
    if bool(flattened.any()):
        found[flattened] = _orthogonal(wide[flattened])
    return found


def _orthogonal(wide: Tensor) -> Tensor:
    left, sizes, right = _singular(wide)
    determinant = torch.linalg.cross(wide[..., 0], wide[..., 1]).mul(wide[..., 2]).sum(dim=-1)
    # `left` never mirrors: where J does, its axis of the smallest size points the other way.
    smallest = sizes.argsort(dim=-1, descending=True, stable=True)[..., -1]
    flip = torch.ones_like(wide[..., 0])
    flip.scatter_(
        -1, smallest[..., None], torch.where(determinant < 0, -1.0, 1.0)[..., None].to(flip)
    )
    return (left * flip.unsqueeze(-2)) @ right.mT


def _singular(matrices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Singular values by Jacobi's method on the columns of M (N, 3, 3), float64.

    Small ones have all their digits where M is a good matrix times a diagonal one, as it is for
    needles and flat Gaussians, and they come in the order of the columns that they are nearest to.

    Returns:
        rotations U (N, 3, 3), sizes s (N, 3), rotations V (N, 3, 3): M = U diag(s) V^T, with the
        smallest size negative where M mirrors, but s holds its magnitude.
    """
    columns = list(matrices.unbind(dim=-1))
    turns = list(torch.eye(3).to(matrices).expand_as(matrices).unbind(dim=-1))
    for _ in range(_SWEEPS):
        if not _sweep(columns, turns):
            break
    sizes = torch.stack([column.norm(dim=-1) for column in columns], dim=-1)
    return _frame(torch.stack(columns, dim=-1), sizes), sizes, torch.stack(turns, dim=-1)


def _sweep(columns: list[Tensor], turns: list[Tensor]) -> bool:
    """Turn each pair of columns until they are perpendicular; whether any was not."""
    changed = False
    for i, j in ((0, 1), (0, 2), (1, 2)):
        a, b = columns[i], columns[j]
        first, second, common = (a * a).sum(-1), (b * b).sum(-1), (a * b).sum(-1)
        apart = common.abs() > _ORTHOGONAL * (first * second).sqrt()
        if not bool(apart.any()):
            continue
        changed = True
        ratio = (second - first) / torch.where(apart, 2 * common, 1.0)
        sign = torch.where(ratio < 0, -1.0, 1.0).to(ratio)
        tangent = torch.where(apart, sign / (ratio.abs() + (1 + ratio * ratio).sqrt()), 0.0)
        cosine = (1 + tangent * tangent).rsqrt().unsqueeze(-1)
        sine = cosine * tangent.unsqueeze(-1)
        for pair in (columns, turns):
            pair[i], pair[j] = cosine * pair[i] - sine * pair[j], sine * pair[i] + cosine * pair[j]
    return changed


def _frame(columns: Tensor, sizes: Tensor) -> Tensor:
    """Rotations (N, 3, 3) whose axes are the directions of perpendicular columns (N, 3, 3).

    The smallest column only says which axis comes last: its direction follows from the others.
    """
    order = sizes.argsort(dim=1, descending=True, stable=True)
    unit = columns / sizes.clamp_min(torch.finfo(sizes.dtype).tiny).unsqueeze(-2)
    long, middle = (_column(unit, order[:, k]) for k in (0, 1))
    ranked = sizes.gather(1, order)
    long = torch.where(ranked[:, :1] > 0, long, torch.eye(3).to(long)[0])
    # Where the second has no size either, any direction across the first will do.
    across = torch.nn.functional.one_hot(long.abs().argmin(dim=1), 3).to(long)
    some = torch.nn.functional.normalize(torch.linalg.cross(long, across), dim=1)
    middle = torch.where((ranked[:, 1] > 1e-14 * ranked[:, 0])[:, None], middle, some)
    short = torch.linalg.cross(long, middle)
    # An odd permutation of the axes turns the direction of the last one round.
    odd = (order[:, 0] + 1) % 3 != order[:, 1]
    short = torch.where(odd[:, None], -short, short)
    sorted_axes = torch.stack([long, middle, short], dim=-1)
    return torch.empty_like(columns).scatter_(2, order[:, None, :].expand_as(columns), sorted_axes)


def _column(matrices: Tensor, index: Tensor) -> Tensor:
    return matrices.gather(2, index[:, None, None].expand(-1, 3, 1)).squeeze(2)


def _check(gaussians: Gaussians, positions: Tensor, local_maps: Tensor) -> None:
    n = len(gaussians)
    if tuple(positions.shape) != (n, 3) or tuple(local_maps.shape) != (n, 3, 3):
        raise EditError(
            f"gaussians: expected positions ({n}, 3) and local maps ({n}, 3, 3), got "
            f"{tuple(positions.shape)} and {tuple(local_maps.shape)}"
        )
    finite = torch.isfinite(positions).all(dim=1)
    finite &= torch.isfinite(local_maps).all(dim=2).all(dim=1).to(finite.device)
    nothing = (local_maps == 0).all(dim=2).all(dim=1).to(finite.device)
    if bool((~finite | nothing).any()):
        raise EditError(
            f"gaussians: the map is not finite at {int((~finite).sum()):,} and shrinks "
            f"{int(nothing.sum()):,} to nothing of {n:,} Gaussians; edit less"
        )

"""Gaussians split where a map bends them inside themselves.

A carried Gaussian follows the map to first order. Along an axis a of standard deviation s what is
left out is, to second order, half of s^2 times the second derivative of the map along a: a needle
that is bent stays straight. Pieces of a standard deviation s / f leave out 1 / f^2 of that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.rotation import rotations

FINEST = 12.0
"""Along an axis no piece is smaller by more than this factor in one pass."""
_REACH = 1.5
"""How many standard deviations away from the mean the map is looked at."""
_PASSES = 3
_SPACING = 1.3
"""Distance between pieces over their standard deviation; where pieces are opaque and lie over each
other like layers, more shows."""
_MARGIN = 1.1
"""Pieces are smaller than need be by this factor, so that rounding splits none of them again."""
_END = 2.4
"""How many standard deviations of the whole the centres of the pieces reach."""
_THINNEST = 0.02
"""Share of a Gaussian's longest standard deviation below which its thickness does not count."""
_OPAQUE = 0.999
_HALVINGS = 24


@dataclass(frozen=True, kw_only=True)
class Refined:
    """Gaussians of which some were split.

    Attributes:
        gaussians: M of them.
        origins: (M,) int64, which of the given ones each is, or is a piece of; ascending.
    """

    gaussians: Gaussians
    origins: Tensor


def refined(gaussians: Gaussians, deformation: Deformation, tolerance: float) -> Refined:
    """Split Gaussians along the axes along which a map bends them.

    They are split before they are moved: what `deformed` makes of the pieces follows the map. The
    pieces look like the whole from across the split axis, and denser from along it.

    Args:
        gaussians: N at rest.
        deformation: the map they will be moved by.
        tolerance: how far, as a share of a moved Gaussian's own standard deviation in that
            direction (at least a fiftieth of its longest), the map may depart from the affine one
            at one standard deviation from the mean.

    Raises:
        InputError: a tolerance that is not greater than 0.
    """
    if not tolerance > 0 or not math.isfinite(tolerance):
        raise InputError(f"refine: expected a tolerance greater than 0, got {tolerance}")
    result = Refined(gaussians=gaussians, origins=torch.arange(len(gaussians)))
    open_ones = torch.arange(len(gaussians))
    for _ in range(_PASSES):
        factors = (bending(_part(result.gaussians, open_ones), deformation) / tolerance).sqrt()
        worst, axes = factors.max(dim=1)
        bent = worst > 1
        if not bool(bent.any()):
            break
        which = open_ones[bent]
        pieces, parents = _split(
            _part(result.gaussians, which), axes[bent], (_MARGIN * worst[bent]).clamp(max=FINEST)
        )
        result, open_ones = _with(result, which, pieces, which[parents])
    return result


def bending(gaussians: Gaussians, deformation: Deformation) -> Tensor:
    """How far a map departs from the affine one within each Gaussian, to second order.

    Returns:
        (N, 3) for each axis the largest departure that splitting it lessens, at one standard
        deviation from the mean, over the standard deviation of the moved Gaussian in the direction
        of the departure; float64.
    """
    if not len(gaussians):
        return torch.zeros(0, 3, dtype=torch.float64)
    own = gaussians.detached().to("cpu", torch.float64)
    middle, jacobian = deformation(own.means), deformation.jacobian(own.means)
    axes = rotations(own.quats) * own.scales.unsqueeze(-2)
    factors = jacobian @ axes

    def second(offset: Tensor) -> Tensor:
        """Half the second derivative along an offset (N, 3)."""
        there, back = (deformation(own.means + sign * _REACH * offset) for sign in (1.0, -1.0))
        return ((there + back) / 2 - middle) / _REACH**2

    pure = [second(axes[..., i]) for i in range(3)]
    result = torch.stack([_shares(one, factors) for one in pure], dim=1)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        # What remains of a diagonal is the mixed derivative: a sheet that is twisted has no other.
        mixed = _shares(second(axes[..., i] + axes[..., j]) - pure[i] - pure[j], factors)
        for axis in (i, j):
            result[:, axis] = torch.maximum(result[:, axis], mixed)
    return result


def _shares(departure: Tensor, factors: Tensor) -> Tensor:
    """Lengths (N,) of departures (N, 3) over the thickness of F F^T, F (N, 3, 3), along them."""
    tiny = torch.finfo(departure.dtype).tiny
    length = departure.norm(dim=1)
    direction = departure / length.clamp_min(tiny)[:, None]
    thickness = (direction.unsqueeze(1) @ factors).squeeze(1).norm(dim=1)
    longest = factors.norm(dim=1).amax(dim=1)
    shares = length / torch.maximum(thickness, _THINNEST * longest).clamp_min(tiny)
    # Not finite is no bend that pieces could follow.
    return shares.nan_to_num(nan=0.0, posinf=0.0)


def _part(gaussians: Gaussians, which: Tensor) -> Gaussians:
    return gaussians.each(lambda tensor: tensor[which.to(tensor.device)])


def _with(
    old: Refined, which: Tensor, pieces: Gaussians, parents: Tensor
) -> tuple[Refined, Tensor]:
    """Put pieces in the place of what they came from; and where they are in the result."""
    kept = torch.ones(len(old.gaussians), dtype=torch.bool)
    kept[which] = False
    stay = kept.nonzero().squeeze(1)
    order = torch.cat([stay, parents]).argsort(stable=True)
    rest = _part(old.gaussians, stay)
    joined = {
        name: torch.cat([getattr(rest, name), value])[order.to(value.device)]
        for name, value in vars(pieces).items()
    }
    origins = torch.cat([old.origins[stay], old.origins[parents]])[order]
    return Refined(gaussians=Gaussians(**joined), origins=origins), (
        order >= len(stay)
    ).nonzero().squeeze(1)


def _split(whole: Gaussians, axes: Tensor, factors: Tensor) -> tuple[Gaussians, Tensor]:
    """Split each of N Gaussians along one of its axes; pieces (M) and their parents (M,).

    Pieces of the standard deviation s / f stand evenly, and are as dense as a Gaussian of the
    variance s^2 - (s / f)^2 says: their sum is the whole.
    """
    # Even the coarsest split has to be one: pieces as large as the whole would fill no row.
    factors = factors.clamp_min(math.sqrt(2)).to(whole.scales.device, torch.float64)
    spread = (1 - factors.pow(-2)).sqrt()
    step = _SPACING / factors
    sides = (_END * spread / step).ceil().long()
    counts = 2 * sides + 1
    parents = torch.arange(len(whole), device=counts.device).repeat_interleave(counts)
    first = (counts.cumsum(0) - counts)[parents]
    number = torch.arange(len(parents), device=counts.device) - first - sides[parents]
    # In standard deviations of the whole.
    place = number * step[parents]
    share = (torch.exp(-0.5 * (place / spread[parents]).square()) / spread[parents]).clamp_max(1.0)
    base = _part(whole, parents)
    chosen = axes.to(counts.device)[parents]
    size = base.scales.gather(1, chosen[:, None]).double()
    direction = rotations(base.quats.double()).gather(2, chosen[:, None, None].expand(-1, 3, 1))
    offset = (place[:, None] * size) * direction.squeeze(2)
    shrunk = base.scales.double().scatter(1, chosen[:, None], size / factors[parents][:, None])
    pieces = replace(
        base,
        means=base.means + offset.to(base.means),
        scales=shrunk.to(base.scales),
        opacities=_opacity(base.opacities.double() * share).to(base.opacities),
    )
    return pieces, parents


def _opacity(target: Tensor) -> Tensor:
    """Opacity (M,) of pieces that together cover as much as (M,) says where they stand.

    Pieces cover each other as layers do: 1 - prod_k (1 - a q_k), with q_k what the k-th neighbour
    has left at this place. Solved by bisection, because it grows with a.
    """
    target = target.clamp(0, _OPAQUE)
    left = [math.exp(-0.5 * (k * _SPACING) ** 2) for k in (0, 1, 1, 2, 2, 3, 3)]
    low, high = torch.zeros_like(target), target.clone()
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        clear = torch.ones_like(target)
        for share in left:
            clear = clear * (1 - middle * share)
        over = 1 - clear > target
        low, high = torch.where(over, low, middle), torch.where(over, middle, high)
    return (low + high) / 2

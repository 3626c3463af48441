"""Local maps of an edit: from its formula, or from where the points went."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn import functional as F

from pcore.deform.base import SINGULAR, Deformation, uprightness
from pcore.deform.checks import check_invertible
from pcore.deform.derivatives import gradients
from pcore.errors import EditError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import size_of
from pcore.geometry.rotation import nearest_rotation

_NEIGHBOURS = 16
_RIDGE = 0.03
_TOLERANCES = (0.4, 0.3, 0.3, 0.2, 0.2, 0.2)
_COMMON = 0.4
"""Which of the changes of length within a neighbourhood, in order, is taken for its scale. Of two
parts torn apart, however large each, almost half of the pairs lie within one of them."""
_LONGEST = 2.5
"""No linear map lengthens anything by more than this times that scale: it is 2.5 for points that
fill space and 1.7 on a sheet. A fit that does so followed neighbours that were torn away."""
_FEWEST = 4
_FLATTEST = 0.05
"""A cloud that extends so much less in one direction than in another is a sheet."""
_COLLAPSED = 1e-4
"""A neighbourhood that shrinks by so much more than the whole cloud has collapsed."""
_FLATNESS = 1e-9
"""Share of the identity in the matrix a rotation is taken from: on a line it chooses the turn."""


def analytic_maps(deformation: Deformation, points: Tensor, *, followed: bool = False) -> LocalMaps:
    """Local maps of canonical points (N, 3), world units, by the Jacobian of a deformation.

    Autograd follows the points, and parameters of the deformation that ask for it.

    Args:
        deformation: the map.
        points: (N, 3).
        followed: refuse a Jacobian that should have a gradient and has none.

    Raises:
        EditError: the map folds space or leaves the finite numbers at some of the points, or its
            `jacobian` loses a gradient.
    """
    places = points.detach().double()
    with torch.no_grad():
        check_invertible(deformation, places)
        mended = deformation.mended(places).nonzero().squeeze(-1)
    return replace(unchecked_maps(deformation, points, followed=followed), mended=mended)


def unchecked_maps(
    deformation: Deformation, points: Tensor, *, followed: bool = False
) -> LocalMaps:
    """As `analytic_maps`, for a deformation that is known to fold nowhere."""
    linear = deformation.jacobian(points.double())
    # Of a linear map the Jacobian is the same everywhere, and rightly without a gradient.
    lost = followed and not linear.requires_grad
    if lost and gradients(deformation, points.double()).requires_grad:
        raise EditError(
            f"{type(deformation).__name__}: a gradient is asked for, and its `jacobian` has none; "
            "leave `jacobian` to the base class, which differentiates the map, or use torch "
            "operations in it"
        )
    return maps_of(points, linear)


def maps_of(points: Tensor, linear: Tensor) -> LocalMaps:
    """Local maps of points (N, 3) from the linear maps (N, 3, 3) around them.

    They are inverted in double precision, and have the dtype and device of the points.
    """
    return LocalMaps(to_rest=_inverse(linear.double()).to(points))


def _inverse(matrices: Tensor) -> Tensor:
    """Inverses (..., 3, 3) by cofactors; faster than a factorisation matrix by matrix."""
    first, second, third = matrices.unbind(dim=-2)
    cofactors = torch.stack(
        [
            torch.linalg.cross(second, third),
            torch.linalg.cross(third, first),
            torch.linalg.cross(first, second),
        ],
        dim=-1,
    )
    determinant = (first * cofactors[..., 0]).sum(dim=-1)
    return cofactors / determinant[..., None, None]


def estimated_maps(rest: Tensor, moved: Tensor) -> LocalMaps:
    """Local maps from where points went, when no formula is known.

    Around every point the linear map that takes its neighbours' offsets to where they are now, by
    least squares, pulled towards a similarity (neighbours lie on a surface and say little across
    it). Neighbours that went elsewhere, on another part that only touched, lose their say by
    iterative reweighting, and what is left of their pull is cut off: a point between parts that
    come apart would be drawn as a spike. The pull also keeps the map of a flattened neighbourhood
    from being singular. Where the fit turns space inside out it is replaced by the similarity, and
    listed in `mended`. A part that is mirrored, or folded over, looks like one that was turned:
    only a mirror of the whole is found out.

    Args:
        rest: (N, 3) canonical points, world units.
        moved: (N, 3) the same points after the deformation.

    Raises:
        EditError: autograd follows the points, for the estimate has no gradient; the clouds differ
            in size, hold fewer than four points, NaN or infinity, or have no extent; or the move
            mirrors the whole.
    """
    _check(rest, moved)
    linear, bad = fitted_maps(rest, moved)
    to_rest = torch.linalg.inv(linear).to(rest)
    return LocalMaps(to_rest=to_rest, mended=torch.nonzero(bad).squeeze(-1))


def fitted_maps(rest: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
    """Linear maps (N, 3, 3) of `estimated_maps` on the CPU, and which (N,) are similarities.

    For finite points of one shape, also few of them: a single point has the identity. Points that
    all went to one place have maps that are zero.
    """
    before, after = rest.detach().cpu().double(), moved.detach().cpu().double()
    if not size_of(before) > 0 or not size_of(after) > 0:
        unit = torch.eye(3, dtype=torch.float64) * float(not size_of(before) > 0)
        return unit.repeat(len(before), 1, 1), torch.zeros(len(before), dtype=torch.bool)
    linear, similar = _fit(before, after)
    bad = ~(uprightness(linear) > SINGULAR)
    return torch.where(bad[:, None, None], similar, linear), bad


def _fit(before: Tensor, after: Tensor) -> tuple[Tensor, Tensor]:
    """Robust linear maps (N, 3, 3) of the neighbourhoods, and the similarities nearest to them."""
    count = min(_NEIGHBOURS, len(before) - 1)
    found = KDTree(before.numpy()).query(before.numpy(), k=count + 1)
    neighbours = torch.from_numpy(np.asarray(found[1])[:, 1:])
    offset, image = before[neighbours] - before[:, None], after[neighbours] - after[:, None]
    tiny = 1e-9 * max(float(before.abs().max()), 1.0)
    length = offset.norm(dim=-1)
    # A neighbour in the same place says nothing.
    near = torch.where(length > tiny, 1.0 / length.clamp_min(tiny), tiny)
    scale = _scale(offset, image, tiny)
    scale = scale.clamp_min(_COLLAPSED * size_of(after) / size_of(before))
    length, unit = length.clamp_min(tiny), torch.eye(3, dtype=before.dtype)
    # A neighbour that is much farther away than the scale says begins with little say.
    trust = (1 + (image.norm(dim=-1) / (scale[:, None] * length) - 1).square()).pow(-2)
    linear = similar = torch.empty(0)
    for tolerance in _TOLERANCES:
        weight = near * trust
        weight = weight / weight.sum(dim=-1, keepdim=True)
        spread = torch.einsum("nk,nki,nkj->nij", weight, offset, offset)
        cross = torch.einsum("nk,nki,nkj->nij", weight, image, offset)
        trace = spread.diagonal(dim1=1, dim2=2).sum(dim=-1)[:, None, None]
        turn = cross / scale[:, None, None] + _FLATNESS * trace * unit
        similar = scale[:, None, None] * nearest_rotation(turn)
        ridge = _RIDGE * trace + tiny**2
        linear = torch.linalg.solve(spread + ridge * unit, cross + ridge * similar, left=False)
        miss = (image - offset @ linear.mT).norm(dim=-1) / (scale[:, None] * length)
        trust = (1 + (miss / tolerance).square()).pow(-2)
    return _shortened(linear, _LONGEST * scale), similar


def _scale(offset: Tensor, image: Tensor, tiny: float) -> Tensor:
    """By what factor (N,) lengths within neighbourhoods (N, k, 3) change; torn ones do not sway it.

    Lengths between all pairs of a point's neighbours, and to itself.
    """
    before, after = (F.pad(points, (0, 0, 0, 1)) for points in (offset, image))
    ratios: list[Tensor] = []
    for shift in range(1, before.shape[1] // 2 + 1):
        length = (before - before.roll(shift, dims=1)).norm(dim=-1)
        moved = (after - after.roll(shift, dims=1)).norm(dim=-1)
        ratios.append(torch.where(length > tiny, moved / length.clamp_min(tiny), torch.nan))
    return torch.cat(ratios, dim=1).nanquantile(_COMMON, dim=1).nan_to_num(nan=1.0)


def _shortened(linear: Tensor, most: Tensor) -> Tensor:
    """The nearest maps (N, 3, 3) that lengthen nothing by more than (N,) factors."""
    left, sizes, right = torch.linalg.svd(linear)
    return left * torch.minimum(sizes, most[:, None])[:, None, :] @ right


def _check(rest: Tensor, moved: Tensor) -> None:
    if torch.is_grad_enabled() and (rest.requires_grad or moved.requires_grad):
        raise EditError(
            "local maps: they are estimated from where points went, which has no gradient, and one "
            "is asked for; detach the points, give local maps, draw with plain rays, or move the "
            "points by a differentiable deformation"
        )
    if rest.shape != moved.shape or rest.ndim != 2 or rest.shape[1] != 3:
        raise EditError(
            "local maps: expected canonical and deformed points of one shape (N, 3), got "
            f"{tuple(rest.shape)} and {tuple(moved.shape)}; both must be the same cloud"
        )
    if len(rest) < _FEWEST:
        raise EditError(
            f"local maps: expected at least {_FEWEST} points to estimate from, got {len(rest)}"
        )
    for name, points in (("canonical", rest), ("deformed", moved)):
        bad = int((~torch.isfinite(points).all(dim=-1)).sum())
        if bad:
            raise EditError(
                f"local maps: expected finite {name} points, got NaN or infinity in {bad} of "
                f"{len(points)}"
            )
        if not size_of(points) > 0:
            raise EditError(
                f"local maps: expected {name} points that extend in space, got all "
                f"{len(points)} in one place"
            )
    if is_mirrored(rest, moved):
        raise EditError(
            "local maps: the move mirrors the object, which turns its inside out; rays cannot be "
            "pulled back. Turn it instead, or render with plain rays"
        )


def is_mirrored(rest: Tensor, moved: Tensor) -> bool:
    """Whether the affine map nearest to the whole move keeps three dimensions and flips one."""
    before, after = (points.detach().cpu().double() for points in (rest, moved))
    if len(before) < _FEWEST:
        return False
    before, after = before - before.mean(dim=0), after - after.mean(dim=0)
    extents = torch.linalg.svdvals(before)
    if float(extents[2]) < _FLATTEST * float(extents[0]):
        return False  # A sheet turned over and a sheet mirrored are the same.
    linear = torch.linalg.lstsq(before, after).solution
    sizes = torch.linalg.svdvals(linear)
    return bool(torch.linalg.det(linear) < 0) and bool(sizes[2] > _FLATTEST * sizes[0])

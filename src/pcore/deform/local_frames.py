"""Local frames of an edit: from its formula, or from where the points went."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from pcore.deform.base import SINGULAR, Deformation, uprightness
from pcore.deform.checks import check_invertible
from pcore.errors import EditError
from pcore.geometry.extent import size_of
from pcore.geometry.local_frames import LocalFrames
from pcore.geometry.rotation import nearest_rotation

_NEIGHBOURS = 16
_RIDGE = 0.03
_TOLERANCES = (0.4, 0.3, 0.3, 0.2, 0.2, 0.2)
_FEWEST = 4
_FLATTEST = 0.05
"""A cloud that extends so much less in one direction than in another is a sheet."""
_COLLAPSED = 1e-4
"""A neighbourhood that shrinks by so much more than the whole cloud has collapsed."""
_FLATNESS = 1e-9
"""Share of the identity in the matrix a rotation is taken from: on a line it chooses the turn."""


def analytic_frames(deformation: Deformation, points: Tensor) -> LocalFrames:
    """Local frames of canonical points (N, 3), world units, by the Jacobian of a deformation.

    Raises:
        EditError: the map folds space or leaves the finite numbers at some of the points.
    """
    places = points.detach().double()
    check_invertible(deformation, places)
    mended = deformation.mended(places).nonzero().squeeze(-1)
    return replace(unchecked_frames(deformation, points), mended=mended)


def unchecked_frames(deformation: Deformation, points: Tensor) -> LocalFrames:
    """As `analytic_frames`, for a deformation that is known to fold nowhere."""
    return frames_of(points, deformation.jacobian(points.detach().double()))


def frames_of(points: Tensor, linear: Tensor) -> LocalFrames:
    """Local frames of canonical points (N, 3) from the linear maps (N, 3, 3) around them.

    The maps are inverted in double precision and have no gradient; the rest positions keep theirs.
    """
    return LocalFrames(rest=points, to_rest=_inverse(linear.detach().double()).to(points))


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


def estimated_frames(rest: Tensor, moved: Tensor) -> LocalFrames:
    """Local frames from where points went, when no formula is known.

    Around every point the linear map that takes its neighbours' offsets to where they are now, by
    least squares, pulled towards a similarity (neighbours lie on a surface and say little across
    it). Neighbours that went elsewhere, on another part that only touched, lose their say by
    iterative reweighting. The pull also keeps the frame of a flattened neighbourhood
    from being singular. Where the fit turns space inside out it is replaced by the similarity, and
    listed in `mended`. A part that is mirrored, or folded over,
    looks like one that was turned: only a mirror of the whole is found out.

    Args:
        rest: (N, 3) canonical points, world units.
        moved: (N, 3) the same points after the deformation.

    Raises:
        EditError: the clouds differ in size, hold fewer than four points, NaN or infinity, or have
            no extent; or the move mirrors the whole.
    """
    _check(rest, moved)
    linear, bad = fitted_maps(rest, moved)
    to_rest = torch.linalg.inv(linear).to(rest)
    return LocalFrames(rest=rest.detach(), to_rest=to_rest, mended=torch.nonzero(bad).squeeze(-1))


def fitted_maps(rest: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
    """Linear maps (N, 3, 3) of `estimated_frames` on the CPU, and which (N,) are similarities.

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
    # The middle neighbour's change of length is a scale that torn-off neighbours cannot sway.
    ratio = torch.where(length > tiny, image.norm(dim=-1) / length.clamp_min(tiny), torch.nan)
    scale = ratio.nanmedian(dim=-1).values.nan_to_num(nan=1.0)
    scale = scale.clamp_min(_COLLAPSED * size_of(after) / size_of(before))
    length = length.clamp_min(tiny)
    trust, unit = torch.ones_like(near), torch.eye(3, dtype=before.dtype)
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
    return linear, similar


def _check(rest: Tensor, moved: Tensor) -> None:
    if rest.shape != moved.shape or rest.ndim != 2 or rest.shape[1] != 3:
        raise EditError(
            "local frames: expected canonical and deformed points of one shape (N, 3), got "
            f"{tuple(rest.shape)} and {tuple(moved.shape)}; both must be the same cloud"
        )
    if len(rest) < _FEWEST:
        raise EditError(
            f"local frames: expected at least {_FEWEST} points to estimate from, got {len(rest)}"
        )
    for name, points in (("canonical", rest), ("deformed", moved)):
        bad = int((~torch.isfinite(points).all(dim=-1)).sum())
        if bad:
            raise EditError(
                f"local frames: expected finite {name} points, got NaN or infinity in {bad} of "
                f"{len(points)}"
            )
        if not size_of(points) > 0:
            raise EditError(
                f"local frames: expected {name} points that extend in space, got all "
                f"{len(points)} in one place"
            )
    if is_mirrored(rest, moved):
        raise EditError(
            "local frames: the move mirrors the object, which turns its inside out; rays cannot be "
            "pulled back. Turn it instead, or render with plain rays"
        )


def is_mirrored(rest: Tensor, moved: Tensor) -> bool:
    """Whether the affine map nearest to the whole move keeps three dimensions and flips one."""
    before, after = (points.detach().cpu().double() for points in (rest, moved))
    if len(before) < _FEWEST:
        return False
    before, after = before - before.mean(dim=0), after - after.mean(dim=0)
    if float(torch.linalg.svdvals(before)[2]) < _FLATTEST * float(torch.linalg.svdvals(before)[0]):
        return False  # A sheet turned over and a sheet mirrored are the same.
    linear = torch.linalg.lstsq(before, after).solution
    sizes = torch.linalg.svdvals(linear)
    return bool(torch.linalg.det(linear) < 0) and bool(sizes[2] > _FLATTEST * sizes[0])

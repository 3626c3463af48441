"""Whether a deformation can be undone near given points."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from pcore.deform.base import SINGULAR, Deformation, orientation
from pcore.errors import EditError

_ROUNDING = 64.0
"""Singular values closer than so many roundings to nothing are taken for nothing."""


class Folds(NamedTuple):
    """At how many points a map cannot be rendered.

    Attributes:
        folded: where it flattens space or turns it inside out.
        sheared: where space stays right side out, but is stretched a thousand times as much in one
            direction as in another, so that single precision cannot carry directions through. That
            is what turning about a far origin does.
    """

    folded: int
    sheared: int


def count_folds(deformation: Deformation, points: Tensor) -> Folds:
    """Count the points (N, 3) where the map folds space, or shears it too much."""
    places = points.detach()
    odd = deformation.folded(places)
    strained = odd & ~(orientation(deformation, places) > SINGULAR)
    sheared = int(_upright(deformation, places[strained]).sum())
    return Folds(folded=int(odd.sum()) - sheared, sheared=sheared)


def check_invertible(
    deformation: Deformation,
    points: Tensor,
    *,
    allow_folds: bool = False,
    advice: str = "lower the amount of the deformation",
) -> None:
    """Raise unless the map keeps space right side out at the points (N, 3), world units.

    Rendering carries directions through the Jacobian, which needs det J > 0. A bare set of points
    can still be moved by a map that folds space in places: `allow_folds` accepts that and
    refuses only maps that keep space right side out nowhere (flattened or mirrored as a whole).

    Args:
        deformation: the map.
        points: (N, 3) where it is looked at.
        allow_folds: see above.
        advice: what the message tells the reader to do about it.

    Raises:
        EditError: det J <= 0, or nearly so, at some of the points (at all of them if folds are
            allowed), or the map leaves the finite numbers; the message counts the points and
            gives the numbers of the first few, from 0.
    """
    total = points.reshape(-1, 3).shape[0]
    check_finite(deformation(points.detach()))
    if allow_folds:
        places = points.detach().reshape(-1, 3)
        folded = ~(orientation(deformation, places) > SINGULAR)
        folded[folded.clone()] = ~_upright(deformation, places[folded])
        folded = folded if bool(folded.all()) else torch.zeros_like(folded)
    else:
        folded = deformation.folded(points.detach()).reshape(-1)
    if not bool(folded.any()):
        return
    raise EditError(
        f"singular deformation: expected space to keep its orientation (det J > 0) at all points, "
        f"got det J <= 0 or nearly 0 at {int(folded.sum())} of {total} points "
        f"({numbers(folded)}), where space is flattened or turned inside out; {advice}"
    )


def _upright(deformation: Deformation, points: Tensor) -> Tensor:
    """Where det J > 0 beyond the rounding of the points' precision: bool (N,) at points (N, 3).

    The closed form of the determinant loses in strong shears what a factorisation keeps.
    """
    if not len(points):
        return torch.zeros(0, dtype=torch.bool, device=points.device)
    with torch.no_grad():
        jacobian = deformation.jacobian(points)
        finite = torch.isfinite(jacobian).all(dim=-1).all(dim=-1)
        jacobian = torch.where(finite[:, None, None], jacobian, 0.0)
        sizes = torch.linalg.svdvals(jacobian)
        thick = sizes[:, -1] > _ROUNDING * torch.finfo(sizes.dtype).eps * sizes[:, 0]
        return finite & thick & (torch.linalg.det(jacobian) > 0)


def check_finite(moved: Tensor) -> None:
    """Raise unless points (N, 3) that a deformation moved are finite.

    Raises:
        EditError: NaN or infinity; the message counts the points and gives the first numbers.
    """
    lost = ~torch.isfinite(moved).all(dim=-1).reshape(-1)
    if bool(lost.any()):
        raise EditError(
            f"the deformation sends {int(lost.sum())} of {lost.numel()} points to NaN or infinity "
            f"({numbers(lost)}), expected finite positions; lower the amount"
        )


def numbers(mask: torch.Tensor, most: int = 5) -> str:
    """Say which points, by number from 0: "numbers 3, 17, 20, ..."."""
    chosen = mask.nonzero().reshape(-1)
    listed = ", ".join(str(int(number)) for number in chosen[:most])
    return f"number{'s' * (len(chosen) > 1)} {listed}{', ...' * (len(chosen) > most)}"

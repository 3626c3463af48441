"""A function of space from values and slopes at scattered points, exact at them.

The interpolant is Shepard's in the local form of Franke and Little (Franke, "Scattered data
interpolation", 1982), with a linear function at every site:

    f(x) = sum_i w_i(x) (v_i + A_i (x - p_i)) / sum_i w_i(x),   w_i = (1 - d_i^2 / R^2)^2 / d_i^2

over the sites nearest to x, R being the distance to the first site that takes no part. At a site it
has the value and the slope of that site.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from pcore.deform.base import (
    SINGULAR,
    Deformation,
    Identity,
    check_points,
    gradients,
    uprightness,
)
from pcore.deform.jacobian import is_mirrored
from pcore.deform.sites import Sites, sites_of
from pcore.errors import InputError
from pcore.geometry.neighbours import as_points
from pcore.geometry.point_cloud import size_of

NEIGHBOURS = 12
"""Sites that answer for a place, and that the gradient of a value is fitted to."""
# Shares of R^2: what keeps a weight finite at its own site, and one site's weight from vanishing
# where all are equally far. Both are far below what double precision resolves of a position.
_AT_SITE, _AT_RIM = 1e-14, 1e-12
_STIFFNESS = 1e-3
_SMALLEST = 1e-30


@dataclass(frozen=True, kw_only=True, eq=False)
class Scattered:
    """An interpolant of values (N, C) at sites (N, 3); it treats each place by itself.

    Continuous, smooth except where the set of answering sites changes, and linear in the values.

    Attributes:
        sites: (N, 3) world units.
        values: (N, C).
        slopes: (N, C, 3) derivatives of the values by position at the sites.
    """

    sites: Tensor
    values: Tensor
    slopes: Tensor
    _known: Sites = field(init=False, repr=False)

    def __post_init__(self) -> None:
        known = sites_of(self.sites)
        places = known.places
        count, width = self.values.shape
        if count != len(places) or self.slopes.shape != (count, width, 3):
            raise InputError(
                f"scattered values: expected one of each for {len(places)} sites, got values "
                f"{tuple(self.values.shape)} and slopes {tuple(self.slopes.shape)}"
            )
        for name in ("sites", "values", "slopes"):
            object.__setattr__(self, name, _own(getattr(self, name)))
        object.__setattr__(self, "_known", known)

    def __call__(self, points: Tensor) -> Tensor:
        """Values (..., C) at points (..., 3); computed in double precision."""
        check_points(points)
        if self._known.are(points):
            return self.values.clone()
        flat = points.reshape(-1, 3).to(torch.float64)
        index = self._nearest(flat)
        away = flat.unsqueeze(1) - self.sites.to(flat.device)[index]
        values = self.values.to(flat.device)[index]
        slopes = self.slopes.to(flat.device)[index]
        local = values + (slopes * away.unsqueeze(-2)).sum(dim=-1)
        squared = away.square().sum(dim=-1)
        share = squared / squared[:, -1:].clamp_min(_SMALLEST)
        weight = ((1 - share).square() + _AT_RIM) / (share + _AT_SITE)
        mean = (weight.unsqueeze(-1) * local).sum(dim=1) / weight.sum(dim=1, keepdim=True)
        # At a site itself to the last bit.
        result = torch.where(squared[:, :1] == 0, local[:, 0], mean)
        return result.reshape(*points.shape[:-1], values.shape[-1]).to(points.dtype)

    def gradient(self, points: Tensor) -> Tensor:
        """Derivatives (..., C, 3) of the values by position; at the sites the slopes there."""
        return self.slopes.clone() if self._known.are(points) else gradients(self, points)

    def nearest(self, points: Tensor) -> Tensor:
        """Number (...,) of the site nearest to each of the points (..., 3)."""
        if self._known.are(points):
            return torch.arange(len(points))
        return self._nearest(points.reshape(-1, 3))[:, 0].reshape(points.shape[:-1])

    def _nearest(self, flat: Tensor) -> Tensor:
        """Numbers (n, k) of the nearest sites, nearest first."""
        k = min(NEIGHBOURS + 1, len(self.sites))
        if flat.shape[0] == 0:
            return torch.zeros(0, k, dtype=torch.int64, device=flat.device)
        places = torch.nan_to_num(flat.detach(), posinf=0.0, neginf=0.0).cpu().numpy()
        _, index = self._known.tree.query(places, k=k)
        numbers = np.asarray(index, dtype=np.int64).reshape(len(places), k)
        return torch.from_numpy(numbers).to(flat.device)


class PointMotion(Deformation):
    """Space that goes along with points whose new places are known, exactly at the points.

    Between the points it is `Scattered` with a linear map at each of them. Places say nothing of
    space turned inside out at a single point, so a map that would do that is replaced there by
    one that does not: see `mended`.
    """

    def __init__(
        self,
        before: Tensor,
        after: Tensor,
        linear: Tensor | None = None,
        *,
        quick: bool = False,
    ) -> None:
        """Prepare the map.

        Args:
            before: (N, 3) world units.
            after: (N, 3) where they go.
            linear: (N, 3, 3) the Jacobian at every point; None takes those of `fitted_maps`, which
                also stand in where a given one flattens space or turns it inside out.
            quick: fit by one least squares, in a twentieth of the time.
        """
        self._sites, self._quick = sites_of(before), quick
        self._after = _own(after)
        self._linear = None if linear is None else _own(linear)

    @cached_property
    def _maps(self) -> tuple[Tensor, Tensor]:
        """Jacobians (N, 3, 3) at the points, and which (N,) are substitutes.

        Where points go is known before them, and often all that is asked for.
        """
        if self._linear is None:
            return self._sites.maps(self._after, quick=self._quick)
        slopes = self._linear
        mended = ~(uprightness(slopes) > SINGULAR)
        if bool(mended.any()):
            fitted, _ = self._sites.maps(self._after, quick=self._quick)
            slopes = torch.where(mended[:, None, None], fitted, slopes)
        return slopes, mended

    @cached_property
    def field(self) -> Scattered:
        """New places as a function of old ones."""
        return Scattered(sites=self._sites.places, values=self._after, slopes=self._maps[0])

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units."""
        check_points(points)
        return self._after.clone() if self._sites.are(points) else self.field(points)

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3); at the points themselves those that were given or fitted."""
        return self.field.gradient(points)

    def eased(self, amount: float) -> Deformation:
        """Return the motion after a share of every point's way: 0 is the identity, 1 this one."""
        if amount == 1.0:
            return self
        if amount == 0.0:
            return Identity()
        sites, unit = self.field.sites, torch.eye(3, dtype=torch.float64)
        after = sites + amount * (self.field.values - sites)
        linear = unit + amount * (self.field.slopes - unit)
        part = PointMotion(sites, after, linear, quick=self._quick)
        part._maps = part._maps[0], part._maps[1] | self._maps[1]
        return part

    def folded(self, points: Tensor) -> Tensor:
        """Where space is flattened or turned inside out; of fitted maps that needs none of them.

        At the points themselves a fit that folds space gives way to a similarity.
        """
        if self._linear is not None or not self._sites.are(points):
            return super().folded(points)
        before, after = self._sites.places, self._after
        gone = size_of(before) > 0 and not size_of(after) > 0
        return torch.full((len(points),), gone or is_mirrored(before, after))

    def folded_given(self, points: Tensor, jacobian: Tensor) -> Tensor:
        """Where space is flattened or turned inside out; everywhere when the whole is mirrored."""
        if is_mirrored(self.field.sites, self.field.values):
            return torch.ones(points.shape[:-1], dtype=torch.bool, device=points.device)
        return super().folded_given(points, jacobian)

    def mended(self, points: Tensor) -> Tensor:
        """Where the nearest of the points has a substitute for its map: bool (...,)."""
        check_points(points)
        return self._maps[1].to(points.device)[self.field.nearest(points)]


def _own(values: Tensor) -> Tensor:
    """A float64 copy on the CPU that nobody else changes."""
    return values.detach().to(device="cpu", dtype=torch.float64, copy=True)


def scalar_slopes(sites: Tensor, values: Tensor) -> Tensor:
    """Gradients (N, 3) of values (N,) fitted to the neighbours of every site by least squares.

    They are zero at the sites of least and of greatest value, where nothing goes beyond.
    """
    source, height = as_points(sites), values.detach().cpu().double().numpy()
    index = _neighbours(source)
    offset = source[index] - source[:, None]
    weight = _closeness(offset)
    moments = np.einsum("nk,nki,nkj->nij", weight, offset, offset)
    rise = np.einsum("nk,nki,nk->ni", weight, offset, height[index] - height[:, None])
    stiff = _STIFFNESS * np.trace(moments, axis1=1, axis2=2)[:, None, None] + _SMALLEST
    slopes = np.linalg.solve(moments + stiff * np.eye(3), rise[..., None])[..., 0]
    slopes[(height == height.min()) | (height == height.max())] = 0.0
    return torch.from_numpy(slopes)


def _neighbours(places: NDArray[np.float64]) -> NDArray[np.int64]:
    k = min(NEIGHBOURS + 1, len(places))
    _, index = KDTree(places).query(places, k=k)
    return np.asarray(index, dtype=np.int64).reshape(len(places), k)


def _closeness(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (N, k) that fall with the distance; the point itself has no say."""
    squared = np.einsum("nki,nki->nk", offset, offset)
    scale = squared.mean(axis=1, keepdims=True) + _SMALLEST
    return np.where(squared > 0, 1.0 / (squared + 0.1 * scale), 0.0)

"""Regions that are known at the points of a cloud only: chosen points, paths over the surface."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from torch import Tensor

from pcore.deform.region import Region, check_falloff, ramp
from pcore.deform.scattered import Scattered, scalar_slopes
from pcore.errors import InputError


class PointRegion(Region):
    """Weights at points, carried into space by `Scattered`; exact at the points.

    Attributes:
        values: (N,) the weights at the points, float64.
    """

    def __init__(self, points: Tensor, values: Tensor) -> None:
        """Prepare the region.

        Args:
            points: (N, 3) world units.
            values: (N,) in [0, 1].

        Raises:
            InputError: another number of values, or values out of range.
        """
        values = values.detach().cpu().double()
        if values.shape != points.shape[:1] or not bool(((values >= 0) & (values <= 1)).all()):
            raise InputError(
                f"region: expected {points.shape[0]} weights between 0 and 1, got "
                f"{tuple(values.shape)}"
            )
        self.values = values
        slopes = scalar_slopes(points, values).unsqueeze(1)
        self._field = Scattered(sites=points, values=values.unsqueeze(1), slopes=slopes)

    def weight(self, points: Tensor) -> Tensor:
        """Weights (...,) at points (..., 3)."""
        if self._at_sites(points):
            return self._own_weights
        return self._field(points).squeeze(-1).clamp(0.0, 1.0)

    def gradient(self, points: Tensor) -> Tensor:
        """See `Region.gradient`."""
        return self._own_gradient if self._at_sites(points) else super().gradient(points)

    def _at_sites(self, points: Tensor) -> bool:
        """Whether these are its own points, at which an edit that is dragged asks again."""
        sites = self._field.sites
        alike = points.dtype == sites.dtype and points.device == sites.device
        return alike and not points.requires_grad and torch.equal(points, sites)

    @cached_property
    def _own_weights(self) -> Tensor:
        return self._field(self._field.sites).squeeze(-1).clamp(0.0, 1.0)

    @cached_property
    def _own_gradient(self) -> Tensor:
        return super().gradient(self._field.sites)


def path_weights(graph: csr_array, sources: Tensor, radius: float, falloff: float) -> Tensor:
    """Weights (N,) by the shortest path over the surface to the nearest of the sources.

    Args:
        graph: (N, N) of `pcore.geometry.neighbours.neighbour_graph`.
        sources: (M,) numbers of points, M at least 1.
        radius: paths up to this length have the weight 1, world units.
        falloff: length over which it falls to 0 beyond, world units.
    """
    check_falloff(falloff)
    length = dijkstra(
        graph,
        directed=False,
        indices=sources.cpu().numpy(),
        min_only=True,
        # Longer paths have no weight: this keeps a small ball in a large cloud quick.
        limit=radius + falloff,
    )
    beyond = np.clip(length - radius, 0.0, 2.0 * falloff + 1.0)
    return ramp(torch.from_numpy(beyond), falloff)

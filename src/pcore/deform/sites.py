"""Places that values are known at, and what is found out about them once."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor

from pcore.deform.base import SINGULAR
from pcore.deform.jacobian import fitted_maps
from pcore.deform.quick_fit import offsets_to, quick_fit
from pcore.geometry.neighbours import as_points

_QUICK_NEIGHBOURS = 10
_MOTIONS = 2
"""Fits of local maps that are kept for the same sites."""


class Sites:
    """N places, with a search tree, their neighbours and the maps of motions from them."""

    def __init__(self, places: NDArray[np.float64]) -> None:
        """Keep places (N, 3), which nobody changes."""
        self.places = torch.from_numpy(places)
        self._fits: dict[tuple[bytes, bool], tuple[Tensor, Tensor]] = {}

    @cached_property
    def tree(self) -> Any:
        """Of SciPy, of all places."""
        return KDTree(self.places.numpy())

    @cached_property
    def distinct(self) -> bool:
        """Whether no two of them are the same."""
        return len(np.unique(self.places.numpy(), axis=0)) == len(self.places)

    def are(self, points: Tensor) -> bool:
        """Whether points are these very places, each with values of its own, with no gradient."""
        alike = points.dtype == torch.float64 and points.device.type == "cpu"
        if points.requires_grad or not alike or points.shape != self.places.shape:
            return False
        return torch.equal(points, self.places) and self.distinct

    def maps(self, after: Tensor, *, quick: bool = False) -> tuple[Tensor, Tensor]:
        """Linear maps (N, 3, 3) of a motion, and which (N,) are similarities: see `fitted_maps`.

        Args:
            after: (N, 3) where the places go.
            quick: by one least squares, unless those of this motion were fitted with care already.
        """
        moved = after.detach().cpu().double()
        key = moved.numpy().tobytes()
        known = self._fits.get((key, False)) or (self._fits.get((key, True)) if quick else None)
        if known is None:
            known = self._quick_maps(moved) if quick else fitted_maps(self.places, moved)
            while len(self._fits) >= _MOTIONS:
                self._fits.pop(next(iter(self._fits)))
            self._fits[key, quick] = known
        return known

    def _quick_maps(self, after: Tensor) -> tuple[Tensor, Tensor]:
        found, bad = quick_fit(after.numpy(), *self._beside, SINGULAR)
        return torch.from_numpy(found.reshape(-1, 3, 3)), torch.from_numpy(bad)

    @cached_property
    def _beside(self) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """(N, K) the nearest others of each, and their `offsets_to` it."""
        count = min(_QUICK_NEIGHBOURS + 1, len(self.places))
        _, index = self.tree.query(self.places.numpy(), k=count)
        beside = np.asarray(index).reshape(-1, count)[:, 1:].astype(np.int32)
        return beside, offsets_to(self.places.numpy(), beside)


def sites_of(points: Tensor) -> Sites:
    """Return what is known of places (N, 3); those asked for last are not looked at again.

    Raises:
        InputError: no points, another shape, NaN or infinity.
    """
    places = as_points(points)
    return _known(places.tobytes())


@lru_cache(maxsize=4)
def _known(content: bytes) -> Sites:
    return Sites(np.frombuffer(content).reshape(-1, 3).copy())

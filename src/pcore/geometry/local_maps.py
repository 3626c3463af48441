"""How space around every point moved when an object was posed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.matrix_tuples import extents

_FLATTEST = 1e-12
_MOST = 0.95


@dataclass(frozen=True, kw_only=True)
class LocalMaps:
    """The way back to rest from around each of N posed points.

    Near point i a deformation is affine: x' = p'_i + A_i (x - p_i). A ray of the posed scene is
    therefore, seen from point i, a ray of the rest state (docs/concepts/deformation-aware-rays.md).

    Attributes:
        to_rest: (N, 3, 3) inverses of the local maps: x - p_i = to_rest_i (x' - p'_i).
        mended: (M,) indices of points whose map is a substitute, because the one that was found
            there would turn space inside out.
    """

    to_rest: Tensor
    mended: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))

    def __post_init__(self) -> None:
        shape = tuple(self.to_rest.shape)
        if len(shape) != 3 or shape[1:] != (3, 3):
            raise InputError(f"local maps: expected matrices (N, 3, 3), got {shape}")

    def __len__(self) -> int:
        return len(self.to_rest)

    def each(self, change: Callable[[Tensor], Tensor]) -> LocalMaps:
        """Return the same with the maps changed."""
        return LocalMaps(to_rest=change(self.to_rest), mended=self.mended)

    @cached_property
    def stretch(self) -> Tensor:
        """(N,) largest factor by which each local map lengthens anything."""
        return (1.0 / self._sizes[:, 2].clamp_min(_FLATTEST)).to(self.to_rest)

    @cached_property
    def anisotropy(self) -> float:
        """Condition number that 95 % of the local maps keep: longest over shortest stretch."""
        ratio = self._sizes[:, 0] / self._sizes[:, 2].clamp_min(_FLATTEST)
        return float(torch.quantile(ratio, _MOST))

    @cached_property
    def growth(self) -> float:
        """How many times as long as at rest things are: median over the points, mean of axes."""
        return float(self._sizes.prod(dim=1).median().clamp_min(_FLATTEST)) ** (-1 / 3)

    @property
    def followed_growth(self) -> float | Tensor:
        """The same as a tensor () where autograd follows the maps."""
        if not (torch.is_grad_enabled() and self.to_rest.requires_grad):
            return self.growth
        volumes = torch.linalg.det(self.to_rest).abs()
        return volumes.median().clamp_min(_FLATTEST).pow(-1 / 3)

    @cached_property
    def _sizes(self) -> Tensor:
        """(N, 3) factors by which `to_rest` changes lengths, largest first."""
        return torch.from_numpy(extents(self.to_rest.detach().cpu().double().contiguous().numpy()))

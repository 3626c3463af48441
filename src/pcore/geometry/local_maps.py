"""What deformed points remember of their rest state: where they were, how space around moved."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor

from pcore.errors import InputError

_FLATTEST = 1e-12
_MOST = 0.95


@dataclass(frozen=True, kw_only=True)
class LocalMaps:
    """The rest state of N deformed points.

    Near point i a deformation is affine: x' = p'_i + A_i (x - p_i). A ray of the deformed scene is
    therefore, seen from point i, a ray of the rest state (docs/concepts/deformation-aware-rays.md).

    Attributes:
        rest: (N, 3) positions p_i before the deformation, world units.
        to_rest: (N, 3, 3) inverses of the local maps: x - p_i = to_rest_i (x' - p'_i).
        mended: (M,) indices of points whose frame is a substitute, because the local map that was
            found there would turn space inside out.
    """

    rest: Tensor
    to_rest: Tensor
    mended: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))

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

    @cached_property
    def _sizes(self) -> Tensor:
        """(N, 3) factors by which `to_rest` changes lengths, largest first."""
        return torch.linalg.svdvals(self.to_rest.detach().double())

    def __post_init__(self) -> None:
        shapes = tuple(self.rest.shape), tuple(self.to_rest.shape)
        if shapes[0][1:] != (3,) or shapes[1] != (*shapes[0], 3):
            raise InputError(
                "local frames: expected rest positions (N, 3) and maps (N, 3, 3), got "
                f"{shapes[0]} and {shapes[1]}"
            )

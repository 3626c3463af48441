"""The neural points: what is learned of an object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.tensors import Tensors


@dataclass(frozen=True, kw_only=True, repr=False)
class PointCloud(Tensors):
    """Extent-free neural points at rest: what is learned.

    Attributes:
        positions: (N, 3) world units.
        features: (N, F) the appearance vector mu of every point.
        influence: (N,) factor on every point's attention score.
    """

    positions: Tensor
    features: Tensor
    influence: Tensor

    def __post_init__(self) -> None:
        n = self.positions.shape[0]
        shapes = [tuple(t.shape) for t in (self.positions, self.features, self.influence)]
        if shapes[0] != (n, 3) or len(shapes[1]) != 2 or shapes[1][0] != n or shapes[2] != (n,):
            raise InputError(
                "point cloud: expected positions (N, 3), features (N, F) and influence (N,), "
                f"got {shapes[0]}, {shapes[1]} and {shapes[2]}"
            )

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> PointCloud:
        """Make a cloud of its tensors by name, as files and optimisers keep them."""
        return cls(
            positions=tensors["positions"],
            features=tensors["features"],
            influence=tensors["influence"],
        )

    def __len__(self) -> int:
        return self.positions.shape[0]

    def extent(self) -> tuple[Tensor, Tensor]:
        """Lower and upper corner of the bounding box, (3,) each."""
        return extent_of(self.positions)


def extent_of(positions: Tensor) -> tuple[Tensor, Tensor]:
    """Lower and upper corner (3,) of the bounding box of points (N, 3)."""
    if len(positions) == 0:
        raise InputError("point cloud: expected at least one point, got none")
    low, high = torch.aminmax(positions.detach(), dim=0)
    return low, high


def size_of(points: Tensor) -> float:
    """Diagonal of the bounding box of points (N, 3), in their unit."""
    low, high = torch.aminmax(points.detach(), dim=0)
    return float((high - low).norm())

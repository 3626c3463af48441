"""The neural points: positions, features, influence."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class PointCloud:
    """Extent-free neural points.

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

    def __len__(self) -> int:
        return self.positions.shape[0]

    def moved(self, positions: Tensor) -> PointCloud:
        """Return the same points at other positions (N, 3)."""
        return replace(self, positions=positions)

    def detached(self) -> PointCloud:
        """Return a copy cut off from the autograd graph."""
        return PointCloud(
            positions=self.positions.detach(),
            features=self.features.detach(),
            influence=self.influence.detach(),
        )

    def to(self, device: torch.device | str) -> PointCloud:
        """Return the same points on a device."""
        return PointCloud(
            positions=self.positions.to(device),
            features=self.features.to(device),
            influence=self.influence.to(device),
        )

    def extent(self) -> tuple[Tensor, Tensor]:
        """Lower and upper corner of the bounding box, (3,) each."""
        if len(self) == 0:
            raise InputError("point cloud: expected at least one point, got none")
        positions = self.positions.detach()
        return torch.amin(positions, dim=0), torch.amax(positions, dim=0)

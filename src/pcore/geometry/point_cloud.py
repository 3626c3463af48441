"""The neural points: positions, features, influence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.surfels import Surfels

_ROUNDING = 1e-5
_BESIDE = 3
_LEAST = 1e-12


@dataclass(frozen=True, kw_only=True)
class PointCloud:
    """Extent-free neural points.

    Attributes:
        positions: (N, 3) world units.
        features: (N, F) the appearance vector mu of every point.
        influence: (N,) factor on every point's attention score.
        frames: rest state of deformed points, with which PAPR sees rays of the rest state
            (deformation-aware rays); None makes the points be seen where they are.
        skin: the surface over the points, in another light than that of the photos perhaps; None
            where nobody knows it.
        before: (N, 3) positions before the points were moved; None where they were not.
    """

    positions: Tensor
    features: Tensor
    influence: Tensor
    frames: LocalMaps | None = None
    skin: Surfels | None = None
    before: Tensor | None = None

    def __post_init__(self) -> None:
        n = self.positions.shape[0]
        shapes = [tuple(t.shape) for t in (self.positions, self.features, self.influence)]
        if shapes[0] != (n, 3) or len(shapes[1]) != 2 or shapes[1][0] != n or shapes[2] != (n,):
            raise InputError(
                "point cloud: expected positions (N, 3), features (N, F) and influence (N,), "
                f"got {shapes[0]}, {shapes[1]} and {shapes[2]}"
            )
        if self.frames is not None and len(self.frames.rest) != n:
            raise InputError(
                f"point cloud: expected local frames of its {n} points, got frames of "
                f"{len(self.frames.rest)}; make them from the same canonical cloud"
            )
        if self.before is not None and self.before.shape != self.positions.shape:
            raise InputError(
                f"point cloud: expected positions before the move of its {n} points, got "
                f"{tuple(self.before.shape)}"
            )
        if self.skin is not None and len(self.skin) != n:
            raise InputError(
                f"point cloud: expected a skin over its {n} points, got {len(self.skin)}"
            )

    @classmethod
    def from_tensors(cls, tensors: Mapping[str, Tensor]) -> PointCloud:
        """Make a canonical cloud of its tensors by name, as files and optimisers keep them."""
        return cls(
            positions=tensors["positions"],
            features=tensors["features"],
            influence=tensors["influence"],
        )

    def __len__(self) -> int:
        return self.positions.shape[0]

    @cached_property
    def moved_as_one(self) -> bool:
        """Whether one affine map moves all points from their rest state, to rounding."""
        if self.frames is None:
            return False
        positions, rest = self.positions.detach(), self.frames.rest.detach()
        to_rest = self.frames.to_rest.detach()
        linear = to_rest[0]
        if float((to_rest - linear).abs().max()) > _ROUNDING * float(linear.abs().max()):
            return False
        offset = rest - positions @ linear.T
        return float((offset - offset[0]).abs().max()) <= _ROUNDING * float(rest.abs().max())

    @cached_property
    def sphere(self) -> tuple[Tensor, float]:
        """Middle (3,) and radius, world units, of a sphere around all points."""
        lower, upper = self.extent()
        middle = (lower + upper) / 2
        return middle, float((self.positions.detach() - middle).norm(dim=-1).max())

    @cached_property
    def growth(self) -> float:
        """How many times as far from their neighbours as before they were moved points are.

        The median over the points; a pose that folds limbs changes nothing.
        """
        if self.frames is not None:
            return self.frames.growth
        if self.before is None or len(self) <= _BESIDE:
            return 1.0
        beside, before = nearest(self.before, self.before, 1 + _BESIDE)
        here = self.positions.detach().cpu()
        after = (here[beside[:, 1:]] - here.unsqueeze(1)).norm(dim=-1)
        sizes = before[:, 1:].sum(dim=1)
        return float((after.sum(dim=1) / sizes.clamp_min(_LEAST)).median())

    def moved(self, positions: Tensor, frames: LocalMaps | None = None) -> PointCloud:
        """Return the same points at other positions (N, 3), with or without their rest state.

        A skin belongs to the positions it was computed for, and is left behind.
        """
        before = self.positions if self.before is None else self.before
        return replace(self, positions=positions, frames=frames, skin=None, before=before)

    def covered(self, skin: Surfels | None) -> PointCloud:
        """Return the same points with this surface over them."""
        return replace(self, skin=skin)

    def detached(self) -> PointCloud:
        """Return a copy cut off from the autograd graph."""
        return self._each(lambda tensor: tensor.detach())

    def to(self, device: torch.device | str) -> PointCloud:
        """Return the same points on a device; this very cloud when it is there already."""
        if self.positions.device == torch.device(device):
            return self
        return self._each(lambda tensor: tensor.to(device))

    def _each(self, change: Callable[[Tensor], Tensor]) -> PointCloud:
        frames = self.frames
        return PointCloud(
            positions=change(self.positions),
            features=change(self.features),
            influence=change(self.influence),
            frames=frames
            and replace(frames, rest=change(frames.rest), to_rest=change(frames.to_rest)),
            skin=None if self.skin is None else self.skin.each(change),
            before=None if self.before is None else change(self.before),
        )

    def extent(self) -> tuple[Tensor, Tensor]:
        """Lower and upper corner of the bounding box, (3,) each."""
        if len(self) == 0:
            raise InputError("point cloud: expected at least one point, got none")
        positions = self.positions.detach()
        return torch.amin(positions, dim=0), torch.amax(positions, dim=0)

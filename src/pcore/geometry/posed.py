"""A cloud in a pose: what is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import PointCloud, extent_of
from pcore.geometry.surfels import Surfels

_ROUNDING = 1e-5
_BESIDE = 3
_LEAST = 1e-12


@dataclass(frozen=True, kw_only=True)
class PosedCloud:
    """Points in a pose, with the surface over them and its light.

    Attributes:
        cloud: the canonical points; their positions are the rest state.
        positions: (N, 3) where the points are now, world units.
        local_maps: how space around each point moved, with which PAPR sees rays of the rest state
            (deformation-aware rays); None lets points be seen where they are.
        surfels: the surface over the posed points, which says how deep pictures are; None where
            nobody knows it.
        gains: (N,) factor on the brightness of the surfels; None leaves that of the photos.
    """

    cloud: PointCloud
    positions: Tensor
    local_maps: LocalMaps | None = None
    surfels: Surfels | None = None
    gains: Tensor | None = None

    def __post_init__(self) -> None:
        n = len(self.cloud)
        if self.positions.shape != self.cloud.positions.shape:
            raise InputError(
                f"posed cloud: expected positions of its {n} points, got "
                f"{tuple(self.positions.shape)}"
            )
        parts = {"local maps": self.local_maps, "surfels": self.surfels, "gains": self.gains}
        for name, part in parts.items():
            if part is not None and len(part) != n:
                raise InputError(
                    f"posed cloud: expected {name} of its {n} points, got {len(part)}; make them "
                    "from the same canonical cloud"
                )
        if self.gains is not None and self.surfels is None:
            raise InputError("posed cloud: expected surfels with gains, got gains alone")

    @classmethod
    def at_rest(cls, cloud: PointCloud, surfels: Surfels | None = None) -> PosedCloud:
        """Pose a canonical cloud (with its surfels at rest) as it is."""
        over = None if surfels is None else surfels.over(cloud.positions)
        return cls(cloud=cloud, positions=cloud.positions, surfels=over)

    def __len__(self) -> int:
        return len(self.cloud)

    @property
    def seen_positions(self) -> Tensor:
        """(N, 3) the points as rays see them: at rest where the way back is known."""
        return self.positions if self.local_maps is None else self.cloud.positions

    @cached_property
    def moved_as_one(self) -> bool:
        """Whether one affine map moves all points from their rest state, to rounding."""
        if self.local_maps is None:
            return False
        positions, rest = self.positions.detach(), self.cloud.positions.detach()
        to_rest = self.local_maps.to_rest.detach()
        linear = to_rest[0]
        if float((to_rest - linear).abs().max()) > _ROUNDING * float(linear.abs().max()):
            return False
        offset = rest - positions @ linear.T
        return float((offset - offset[0]).abs().max()) <= _ROUNDING * float(rest.abs().max())

    @cached_property
    def sphere(self) -> tuple[Tensor, float]:
        """Middle (3,) and radius, world units, of a sphere around all points."""
        lower, upper = extent_of(self.positions)
        middle = (lower + upper) / 2
        return middle, float((self.positions.detach() - middle).norm(dim=-1).max())

    @property
    def followed_sphere(self) -> tuple[Tensor, float | Tensor]:
        """The same, with its radius a tensor () where autograd follows the points."""
        if not (torch.is_grad_enabled() and self.positions.requires_grad):
            return self.sphere
        middle = (self.positions.amin(dim=0) + self.positions.amax(dim=0)) / 2
        return middle, (self.positions - middle).norm(dim=-1).max()

    @cached_property
    def growth(self) -> float:
        """How many times as far from their neighbours as at rest points are.

        The median over the points; a pose that folds limbs changes nothing.
        """
        if self.local_maps is not None:
            return self.local_maps.growth
        if self.positions is self.cloud.positions or len(self) <= _BESIDE:
            return 1.0
        rest = self.cloud.positions
        beside, before = nearest(rest, rest, 1 + _BESIDE)
        here = self.positions.detach().cpu()
        after = (here[beside[:, 1:]] - here.unsqueeze(1)).norm(dim=-1)
        sizes = before[:, 1:].sum(dim=1)
        return float((after.sum(dim=1) / sizes.clamp_min(_LEAST)).median())

    @property
    def asks_gradient(self) -> bool:
        """Whether autograd follows any part."""
        parts = [self.positions, self.cloud.positions, self.cloud.features, self.cloud.influence]
        if self.local_maps is not None:
            parts.append(self.local_maps.to_rest)
        if self.surfels is not None:
            parts += [self.surfels.places, self.surfels.normals]
        if self.gains is not None:
            parts.append(self.gains)
        return torch.is_grad_enabled() and any(part.requires_grad for part in parts)

    def to(self, device: torch.device | str) -> PosedCloud:
        """Return the same on a device; this very pose when it is there already."""
        if self.positions.device == torch.device(device):
            return self
        return self.each(lambda tensor: tensor.to(device))

    def each(self, change: Callable[[Tensor], Tensor]) -> PosedCloud:
        """Return the same with every tensor changed."""
        cloud = self.cloud.each(change)
        still = self.positions is self.cloud.positions
        return PosedCloud(
            cloud=cloud,
            positions=cloud.positions if still else change(self.positions),
            local_maps=None if self.local_maps is None else self.local_maps.each(change),
            surfels=None if self.surfels is None else self.surfels.each(change),
            gains=None if self.gains is None else change(self.gains),
        )

"""Bundles of rays: origins and unit directions of any batch shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError


@dataclass(frozen=True, kw_only=True)
class RayBundle:
    """Rays x(s) = origin + s direction, world units.

    Attributes:
        origins: (..., 3).
        directions: (..., 3), unit length.
    """

    origins: Tensor
    directions: Tensor

    def __post_init__(self) -> None:
        if self.origins.shape != self.directions.shape or self.origins.shape[-1] != 3:
            raise InputError(
                "rays: expected origins and directions of one shape (..., 3), got "
                f"{tuple(self.origins.shape)} and {tuple(self.directions.shape)}"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape, without the last axis."""
        return tuple(self.directions.shape[:-1])

    def __getitem__(self, index: Any) -> RayBundle:
        """Return the rays that a tensor of indices, a mask or slices choose."""
        return RayBundle(origins=self.origins[index], directions=self.directions[index])

    def flat(self) -> RayBundle:
        """Return the same rays with batch shape (R,)."""
        return RayBundle(
            origins=self.origins.reshape(-1, 3), directions=self.directions.reshape(-1, 3)
        )

    def to(self, device: torch.device | str) -> RayBundle:
        """Return the same rays on a device."""
        return RayBundle(origins=self.origins.to(device), directions=self.directions.to(device))

    def crop(self, top: int, left: int, height: int, width: int) -> RayBundle:
        """Rectangle of an (H, W) bundle."""
        window = (slice(top, top + height), slice(left, left + width))
        return RayBundle(origins=self.origins[window], directions=self.directions[window])

    def beside(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Where points (..., 3) lie beside the lines of the rays; both are broadcast.

        Returns:
            How far along the rays (..., 1), and the offsets (..., 3) across them, world units.
        """
        offset = points - self.origins
        along = (offset * self.directions).sum(dim=-1, keepdim=True)
        return along, offset - along * self.directions

    def slid(self, center: Tensor, distance: float) -> RayBundle:
        """Slide the origins along their rays to `distance` before the plane through `center`.

        The lines stay the same. What PAPR sees of a slid ray no longer depends on how far away the
        camera was.

        Args:
            center: (3,) world units.
            distance: along each ray from its new origin to where it is closest to the center.
        """
        ahead = ((center - self.origins) * self.directions).sum(dim=-1, keepdim=True)
        return RayBundle(
            origins=self.origins + (ahead - distance) * self.directions,
            directions=self.directions,
        )


def perpendicular(directions: Tensor) -> Tensor:
    """One unit vector (N, 3) at right angles to each of some unit directions (N, 3)."""
    least = F.one_hot(directions.abs().argmin(dim=-1), 3).to(directions)
    return F.normalize(torch.linalg.cross(directions, least), dim=-1)

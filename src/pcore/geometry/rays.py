"""Bundles of rays: origins and unit directions of any batch shape."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.tensors import Tensors

_UNIT = 1e-3
"""By so much the length of a direction may be off."""


@dataclass(frozen=True, kw_only=True, repr=False)
class RayBundle(Tensors):
    """Rays x(s) = origin + s direction, world units.

    Attributes:
        origins: (..., 3), or (..., S, 3) with S rays per pixel.
        directions: of the same shape, unit length.
        samples: S, where the last axis of the batch shape holds the rays of one pixel; None where
            every ray is a pixel of its own.
    """

    origins: Tensor
    directions: Tensor
    samples: int | None = None

    def __post_init__(self) -> None:
        shape = tuple(self.directions.shape)
        if self.origins.shape != self.directions.shape or shape[-1:] != (3,):
            raise InputError(
                "rays: expected origins and directions of one shape (..., 3), got "
                f"{tuple(self.origins.shape)} and {shape}"
            )
        if self.samples is not None and shape[-2:-1] != (self.samples,):
            raise InputError(
                f"rays: expected {self.samples} rays per pixel along the last axis, got rays of "
                f"shape {shape[:-1]}"
            )

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape, without the last axis."""
        return tuple(self.directions.shape[:-1])

    @property
    def pixels(self) -> tuple[int, ...]:
        """Batch shape of the pixels: without the axis of their rays."""
        return self.shape if self.samples is None else self.shape[:-1]

    @property
    def asks_gradient(self) -> bool:
        """Whether autograd follows the rays."""
        followed = self.origins.requires_grad or self.directions.requires_grad
        return torch.is_grad_enabled() and followed

    def checked(self) -> RayBundle:
        """Return the same rays; InputError: none, not of unit length, or from no finite place."""
        lengths = self.directions.detach().norm(dim=-1)
        if not lengths.numel() or not bool(((lengths - 1).abs() < _UNIT).all()):
            got = f"lengths up to {float(lengths.max()):g}" if lengths.numel() else "no rays"
            raise InputError(
                f"rays: expected directions of unit length, got {got}; divide them by their norm"
            )
        if not bool(self.origins.isfinite().all()):
            raise InputError("rays: expected finite origins, got NaN or infinity")
        return self

    def __getitem__(self, index: Any) -> RayBundle:
        """Return the pixels that a tensor of indices, a mask or slices choose."""
        return self.each(lambda tensor: tensor[index])

    def flat(self) -> RayBundle:
        """Return the same rays, every one a pixel of its own, with batch shape (R,)."""
        return RayBundle(
            origins=self.origins.reshape(-1, 3), directions=self.directions.reshape(-1, 3)
        )

    def by_pixel(self) -> RayBundle:
        """Return the same rays with batch shape (P, S)."""
        samples = self.samples or 1
        return RayBundle(
            origins=self.origins.reshape(-1, samples, 3),
            directions=self.directions.reshape(-1, samples, 3),
            samples=samples,
        )

    def at(self, distances: Tensor) -> Tensor:
        """Places (..., 3) at distances (...) along the rays, world units; NaN where those are NaN.

        Rays whose distance is not known have no gradient, rather than one that is NaN.
        """
        known = distances.isfinite()
        steps = distances.where(known, 0.0).unsqueeze(-1)
        places = self.origins.to(steps) + steps * self.directions.to(steps)
        return places.masked_fill(~known.unsqueeze(-1), math.nan)

    def crop(self, top: int, left: int, height: int, width: int) -> RayBundle:
        """Rectangle of an (H, W) bundle."""
        return self[top : top + height, left : left + width]

    def beside(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Where points (..., 3) lie beside the lines of the rays; both are broadcast.

        Returns:
            How far along the rays (..., 1), and the offsets (..., 3) across them, world units.
        """
        offset = points - self.origins
        along = (offset * self.directions).sum(dim=-1, keepdim=True)
        return along, offset - along * self.directions

    def middle(self) -> RayBundle:
        """Return one ray (P,) in the middle of the rays (P, S) of each pixel."""
        if self.samples in (None, 1):
            return self.flat()
        direction = F.normalize(self.directions.mean(dim=-2), dim=-1)
        return RayBundle(origins=self.origins.mean(dim=-2), directions=direction)

    def width_at(self, points: Tensor) -> Tensor:
        """How far (P,) the rays (P, S) of pixels lie from their middle beside points (P, 3)."""
        middle = self.middle()
        along, _ = middle.beside(points)
        foot = along * middle.directions
        places = self.origins - middle.origins[:, None] + along[:, None] * self.directions
        return (places - foot[:, None]).square().sum(dim=-1).amax(dim=1).sqrt()

    def from_other_ends(self, center: Tensor, radius: float | Tensor) -> RayBundle:
        """Return the same lines from their other ends, as far behind a sphere's middle as before.

        Args:
            center: (3,) of the sphere, world units.
            radius: of the sphere; from within it lines begin outside.
        """
        ahead = ((center - self.origins) * self.directions).sum(dim=-1, keepdim=True)
        length = 2 * ahead.clamp_min(radius)
        return replace(
            self, origins=self.origins + length * self.directions, directions=-self.directions
        )

    def slid(self, center: Tensor, distance: float) -> RayBundle:
        """Slide the origins along their rays to `distance` before the plane through `center`.

        The lines stay the same. What PAPR sees of a slid ray no longer depends on how far away the
        camera was.

        Args:
            center: (3,) world units.
            distance: along each ray from its new origin to where it is closest to the center.
        """
        ahead = ((center - self.origins) * self.directions).sum(dim=-1, keepdim=True)
        return replace(self, origins=self.origins + (ahead - distance) * self.directions)


def perpendicular(directions: Tensor) -> Tensor:
    """One unit vector (N, 3) at right angles to each of some unit directions (N, 3)."""
    least = F.one_hot(directions.abs().argmin(dim=-1), 3).to(directions)
    return F.normalize(torch.linalg.cross(directions, least), dim=-1)

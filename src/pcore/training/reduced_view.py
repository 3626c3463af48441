"""Training views with smaller photos, for a training from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.camera import Camera

_WHOLE = 0.999
"""Share of a reduced pixel that the photo must show."""


class Photo(Protocol):
    """What a training asks of a view."""

    @property
    def camera(self) -> Camera:
        """Pose and intrinsics of the photo."""
        ...

    @property
    def has_alpha(self) -> bool:
        """Whether the photo separates object from background."""
        ...

    def rgba(self) -> Tensor:
        """(H, W, 4) float32 straight alpha."""
        ...

    def valid(self) -> Tensor | None:
        """(H, W) bool: pixels that the photo shows; None: all of them."""
        ...


@dataclass(frozen=True, kw_only=True)
class ReducedView:
    """A view with both sides of its photo divided by a whole number, rounded.

    Attributes:
        view: as it is in the scene.
        reduction: the divisor.
    """

    view: Photo
    reduction: int

    @property
    def has_alpha(self) -> bool:
        """See `Photo.has_alpha`."""
        return self.view.has_alpha

    @property
    def camera(self) -> Camera:
        """The camera of the reduced photo."""
        return self._camera

    @cached_property
    def _camera(self) -> Camera:
        camera = self.view.camera
        width, height = (
            max(1, round(side / self.reduction)) for side in (camera.width, camera.height)
        )
        return camera.resized(width, height)

    def rgba(self) -> Tensor:
        """(H, W, 4) the area mean of premultiplied colour. Shared: do not write to it."""
        return self._rgba

    def valid(self) -> Tensor | None:
        """(H, W) bool: pixels that the photo shows whole. Shared: do not write to it."""
        return self._valid

    @cached_property
    def _rgba(self) -> Tensor:
        rgba = self.view.rgba()
        alpha = rgba[..., 3:]
        mean = self._mean(torch.cat([rgba[..., :3] * alpha, alpha], dim=-1))
        covered = mean[..., 3:]
        color = torch.where(covered > 0, mean[..., :3] / covered.clamp_min(1e-12), 0.0)
        return torch.cat([color.clamp(0.0, 1.0), covered], dim=-1)

    @cached_property
    def _valid(self) -> Tensor | None:
        valid = self.view.valid()
        if valid is None:
            return None
        return self._mean(valid.float().unsqueeze(-1))[..., 0] > _WHOLE

    def _mean(self, image: Tensor) -> Tensor:
        size = (self.camera.height, self.camera.width)
        layers = image.permute(2, 0, 1).unsqueeze(0)
        return F.interpolate(layers, size=size, mode="area")[0].permute(1, 2, 0)


def reduced(views: Sequence[Photo], reduction: int) -> Sequence[Photo]:
    """Views with reduced photos, made when they are asked for; 1 gives the views themselves."""
    if reduction == 1:
        return views
    return [ReducedView(view=view, reduction=reduction) for view in views]


class PhotosInTurn:
    """The views of a training at the resolution that its progress asks for."""

    def __init__(self, views: Sequence[Photo]) -> None:
        self._views = views
        self._reduction, self._now = 1, views

    def at(self, reduction: int) -> Sequence[Photo]:
        """Views at a resolution; those of the one before are forgotten."""
        if reduction != self._reduction:
            self._reduction, self._now = reduction, reduced(self._views, reduction)
        return self._now

"""Training photos and their cameras at one resolution of a training from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.gaussians.render import view_matrices
from pcore.geometry.camera import Camera


@dataclass(frozen=True, kw_only=True)
class PhotoLevel:
    """Views with both sides of their photos divided by a whole number.

    Attributes:
        views: as they are in the scene.
        reduction: the divisor; 1 leaves them as they are.
    """

    views: Sequence[View]
    reduction: int
    _reduced: dict[int, Tensor] = field(default_factory=dict[int, Tensor], repr=False)

    def camera(self, index: int) -> Camera:
        """The camera of a view for its reduced photo."""
        camera = self.views[index].camera
        if self.reduction == 1:
            return camera
        return camera.resized(*_size(camera, self.reduction))

    def matrices(self, index: int, like: Tensor) -> tuple[Tensor, Tensor, tuple[int, int]]:
        """Camera from world (1, 4, 4), pinhole (1, 3, 3), width and height."""
        camera = self.camera(index)
        return *view_matrices([camera], like), (camera.width, camera.height)

    def rgba(self, index: int) -> Tensor:
        """(H, W, 4) straight alpha, the area mean of premultiplied colour. Do not write to it."""
        if self.reduction == 1:
            return self.views[index].rgba()
        if index not in self._reduced:
            self._reduced[index] = _reduced(self.views[index], self.reduction)
        return self._reduced[index]


def _size(camera: Camera, reduction: int) -> tuple[int, int]:
    return max(1, round(camera.width / reduction)), max(1, round(camera.height / reduction))


def _reduced(view: View, reduction: int) -> Tensor:
    width, height = _size(view.camera, reduction)
    rgba = view.rgba()
    alpha = rgba[..., 3:]
    layers = torch.cat([rgba[..., :3] * alpha, alpha], dim=-1).permute(2, 0, 1).unsqueeze(0)
    mean = F.interpolate(layers, size=(height, width), mode="area")[0].permute(1, 2, 0)
    covered = mean[..., 3:]
    color = torch.where(covered > 0, mean[..., :3] / covered.clamp_min(1e-12), 0.0)
    return torch.cat([color.clamp(0.0, 1.0), covered], dim=-1)

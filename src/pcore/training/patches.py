"""Random patches of training views: rays and what they should show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.data.images import background_color, composite
from pcore.geometry.pixel_samples import drawn_places
from pcore.geometry.rays import RayBundle
from pcore.training.config import Background, PatchConfig
from pcore.training.reduced_view import Photo

_TRIES = 20
_LEAST_COVERAGE = 0.02


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A square of one view.

    Attributes:
        rays: (H, W) rays, or (H, W, S) with S of them per pixel, world units.
        rgb: (H, W, 3) photo over the background.
        alpha: (H, W) coverage, None for photos without an alpha channel.
        background: (3,) colour behind the object.
        valid: (H, W) pixels that the photo shows; None: all of them.
        view: number of the view.
    """

    rays: RayBundle
    rgb: Tensor
    alpha: Tensor | None
    background: Tensor
    valid: Tensor | None = None
    view: int = 0

    def told(self, rendered: Tensor, photo: Tensor) -> Tensor:
        """The rendered values (H, W, ...), and the photo's where it shows nothing.

        There, rendering is neither right nor wrong: the difference and its gradient are zero.
        """
        if self.valid is None:
            return rendered
        valid = self.valid.reshape(self.valid.shape + (1,) * (rendered.ndim - 2))
        return torch.where(valid, rendered, photo)


def draw_patch(
    views: Sequence[Photo],
    config: PatchConfig,
    background: Background,
    generator: torch.Generator,
    device: torch.device,
) -> Patch:
    """Draw a view and a patch of it; patches that miss the object are drawn again.

    Returns:
        The patch on `device`; every draw comes from `generator`.
    """
    index = _draw(len(views), generator)
    view = views[index]
    camera = view.camera
    height, width = min(config.side, camera.height), min(config.side, camera.width)
    rgba = view.rgba()
    top = left = 0
    for _ in range(_TRIES):
        top = _draw(camera.height - height + 1, generator)
        left = _draw(camera.width - width + 1, generator)
        coverage = rgba[top : top + height, left : left + width, 3].mean()
        if not view.has_alpha or float(coverage) > _LEAST_COVERAGE:
            break
    crop = rgba[top : top + height, left : left + width]
    valid = view.valid()
    if valid is not None:
        valid = _sent(valid[top : top + height, left : left + width], device)
    color = background_color(background, generator)
    places = None
    if config.samples > 1:
        places = drawn_places(height, width, config.samples, generator)
    rays = camera.rays(top, left, height, width, places=places)
    return Patch(
        rays=rays.each(lambda tensor: _sent(tensor, device)),
        rgb=_sent(composite(crop, color), device),
        alpha=_sent(crop[..., 3], device) if view.has_alpha else None,
        background=_sent(color, device),
        valid=valid,
        view=index,
    )


def _sent(tensor: Tensor, device: torch.device) -> Tensor:
    """Put a tensor on a device; nobody waits for a GPU to be done with the step before."""
    if device.type != "cuda":
        return tensor.to(device)
    return tensor.contiguous().pin_memory().to(device, non_blocking=True)


def _draw(bound: int, generator: torch.Generator) -> int:
    return int(torch.randint(bound, (1,), generator=generator))

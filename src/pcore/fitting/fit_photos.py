"""Photos of a deformed state, prepared for a fit: smaller pictures with their cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.errors import InputError
from pcore.geometry.camera import Camera

_SEEN = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Photo:
    """One photo.

    Attributes:
        name: of its view.
        camera: who took it.
        color: (H, W, 3) colours times opacity.
        alpha: (H, W) opacity of the object.
        known: (H, W) share of every pixel that the photo shows, in [0, 1].
    """

    name: str
    camera: Camera
    color: Tensor
    alpha: Tensor
    known: Tensor

    def over(self, background: Tensor) -> Tensor:
        """(H, W, 3) the object before a background (3,)."""
        return self.color + (1 - self.alpha).unsqueeze(-1) * background

    def at_most(self, pixels: int) -> Photo:
        """Return the photo with its longest side at most so long, by means over areas."""
        height, width = self.alpha.shape
        shrink = min(1.0, pixels / max(width, height))
        size = (max(4, round(height * shrink)), max(4, round(width * shrink)))
        if size == (height, width):
            return self
        known = self.known.unsqueeze(-1)
        stack = torch.cat([self.color * known, self.alpha.unsqueeze(-1) * known, known], dim=-1)
        mean = F.adaptive_avg_pool2d(stack.movedim(-1, 0), size).movedim(0, -1)
        shown = mean[..., 4]
        mean = mean[..., :4] / shown.clamp_min(_SEEN).unsqueeze(-1)
        return Photo(
            name=self.name,
            camera=self.camera.resized(size[1], size[0]),
            color=mean[..., :3],
            alpha=mean[..., 3],
            known=shown,
        )


def photos_of(views: Sequence[View], device: torch.device) -> tuple[Photo, ...]:
    """Read photos and what separates the object from the background in them.

    Raises:
        InputError: no photo, one without mask, or one in which the object is not.
    """
    if not views:
        raise InputError("photos: expected at least one of the deformed state, got none")
    bare = [view.name for view in views if not view.has_alpha]
    if bare:
        raise InputError(
            f"photos: expected pictures with an alpha channel or masks, got none for "
            f"{', '.join(bare[:3])}{' and others' if len(bare) > 3 else ''}; put masks of the same "
            "names in a folder `masks` beside the photos (docs/guide/captures.md)"
        )
    found = tuple(_photo(view, device) for view in views)
    empty = [one.name for one in found if float(one.alpha.sum()) < 1]
    if empty:
        raise InputError(
            f"photos: expected the object in all of them, got an empty mask in {', '.join(empty)}; "
            "leave them out"
        )
    return found


def _photo(view: View, device: torch.device) -> Photo:
    rgba = view.rgba().to(device)
    valid = view.valid()
    alpha = rgba[..., 3]
    known = torch.ones_like(alpha) if valid is None else valid.to(alpha)
    return Photo(
        name=view.name,
        camera=view.camera,
        color=rgba[..., :3] * rgba[..., 3:],
        alpha=alpha,
        known=known,
    )


def in_turns(photos: Sequence[Photo], count: int, seed: int) -> Iterator[list[Photo]]:
    """Give so many photos at a time, for ever; each comes as often as the others."""
    generator = torch.Generator().manual_seed(seed)
    waiting: list[int] = []
    count = min(count, len(photos))
    while True:
        if len(waiting) < count:
            fresh = torch.randperm(len(photos), generator=generator).tolist()
            waiting += [number for number in fresh if number not in waiting]
        yield [photos[number] for number in waiting[:count]]
        waiting = waiting[count:]

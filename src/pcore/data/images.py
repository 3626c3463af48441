"""Image files as float32 straight-alpha RGBA, down-scaled by area, decoded when they are needed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from pcore.data.image_files import ImageHeader, read_mask, read_rgba
from pcore.errors import InputError
from pcore.geometry.lens_distortion import LensDistortion
from pcore.validation import check_count

DEFAULT_MEMORY_BUDGET = 2 * 1024**3
_SOLID = 0.5

Crop = tuple[int, int, int, int]
"""Left, top, right and lower end of a part of a picture, pixels."""


class ImageCache:
    """Decoded images, least recently used thrown out first; safe to share between threads.

    The budget bounds what is KEPT between calls. Images being decoded or handed out right now
    come on top of it; an image larger than the whole budget is handed out and not kept.
    """

    def __init__(self, memory_budget: int = DEFAULT_MEMORY_BUDGET) -> None:
        self.memory_budget = check_count("memory budget in bytes", memory_budget, minimum=0)
        self._images: OrderedDict[Hashable, Tensor] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def bytes_used(self) -> int:
        """Bytes of all images kept now."""
        with self._lock:
            return self._bytes

    def get(self, key: Hashable, decode: Callable[[], Tensor]) -> Tensor:
        """Return the image kept under `key`, or decode and keep it. Do not write to the result."""
        with self._lock:
            kept = self._images.get(key)
            if kept is not None:
                self._images.move_to_end(key)
                return kept
        # Outside the lock, so that threads decode different images at the same time.
        image = decode()
        self._keep(key, image)
        return image

    def _keep(self, key: Hashable, image: Tensor) -> None:
        size = image.numel() * image.element_size()
        with self._lock:
            if key in self._images or size > self.memory_budget:
                return
            while self._bytes + size > self.memory_budget:
                _, oldest = self._images.popitem(last=False)
                self._bytes -= oldest.numel() * oldest.element_size()
            self._images[key] = image
            self._bytes += size


@dataclass(kw_only=True)
class AlphaOfSplit:
    """Whether the alpha channels of a split separate an object from a background.

    Tools write an alpha of 255 everywhere into every image; that is no mask.

    Attributes:
        sources: of all images of the split.
    """

    sources: list[ImageSource] = field(default_factory=list["ImageSource"])

    @cached_property
    def separates(self) -> bool:
        """Whether any pixel of any image is background. Decodes until one is found."""
        return any(
            bool(((source.rgba()[..., 3] <= _SOLID) & source.shown()).any())
            for source in self.sources
            if source.header.has_alpha
        )


@dataclass(frozen=True, kw_only=True)
class ImageSource:
    """One image file of a scene, decoded on request.

    Attributes:
        path: the file.
        header: the size it must have before down-scaling; `has_alpha` counts a mask too.
        factor: whole number by which both sides are divided.
        cache: shared by all views of a scene.
        mask: file of a mask that the alpha is multiplied by; None is none.
        upright: turn the pixels as the EXIF tag says.
        lens: that bent the whole picture as it is decoded; None of a pinhole.
        crop: part that is kept of the straight picture before down-scaling; None keeps all.
        clear: greys in [0, 1] that are background where a pixel of the file has exactly one.
        alpha: of the split that it belongs to; None takes any alpha channel for a mask.
        cut: (H, W) uint8 mask of the finished picture that the alpha is multiplied by, 255 is
            object; None is none.
    """

    path: Path
    header: ImageHeader
    factor: int
    cache: ImageCache
    mask: Path | None = None
    upright: bool = False
    lens: LensDistortion | None = None
    crop: Crop | None = None
    clear: tuple[float, ...] = ()
    alpha: AlphaOfSplit | None = field(default=None, repr=False, compare=False)
    cut: Tensor | None = field(default=None, repr=False, compare=False)

    @property
    def has_alpha(self) -> bool:
        """Whether the file, or its mask, separates object from background."""
        if self.cut is not None:
            return True
        return self.header.has_alpha and (self.alpha is None or self.alpha.separates)

    def rgba(self) -> Tensor:
        """(H, W, 4) float32 straight alpha in [0, 1]. Shared with the cache: do not write to it.

        Pixels that the photo says nothing about (`valid`) are 0 in all channels.
        """
        key = (self.path, self.mask, self.upright, self.lens, self.crop, self.factor, self.clear)
        found = self.cache.get(key, self._decode)
        if self.cut is None:
            return found
        cut = self.cut[..., None].float() / 255
        return torch.cat([found[..., :3], found[..., 3:] * cut], dim=-1)

    def valid(self) -> Tensor | None:
        """(H, W) bool: pixels that the photo shows; None where it shows all.

        Straightening a picture leaves pixels at its borders that the lens did not see. Shared with
        the cache: do not write to it.
        """
        if self.lens is None:
            return None
        lens, size = self.lens, self.size
        return self.cache.get(self._valid_key, lambda: self._shrunk(lens.sources(*size)[1]))

    def shown(self) -> Tensor:
        """(H, W) or () bool: `valid`, or one value for all pixels."""
        valid = self.valid()
        return torch.tensor(True) if valid is None else valid

    @property
    def _valid_key(self) -> Hashable:
        return ("valid", self.size, self.lens, self.crop, self.factor)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the whole picture as it is decoded, before lens, crop and factor."""
        header = self.header
        return header.upright_size if self.upright else (header.width, header.height)

    def _decode(self) -> Tensor:
        stored = (self.header.width, self.header.height)
        rgba = read_rgba(self.path, size=stored, upright=self.upright)
        for grey in self.clear:
            rgba[..., 3].masked_fill_((rgba[..., :3] == grey).all(dim=-1), 0.0)
        if self.mask is not None:
            mask = read_mask(self.mask, size=(rgba.shape[1], rgba.shape[0]))
            rgba = torch.cat([rgba[..., :3], rgba[..., 3:] * mask[..., None]], dim=-1)
        if self.lens is None:
            return area_downscale(_part(rgba, self.crop), self.factor)
        places, seen = self.lens.sources(*self.size)
        rgba = straight_picture(rgba, places)
        valid = self.cache.get(self._valid_key, lambda: self._shrunk(seen))
        return area_downscale(_part(rgba, self.crop), self.factor) * valid[..., None]

    def _shrunk(self, seen: Tensor) -> Tensor:
        """Pixels of the down-scaled part that are seen whole."""
        seen = _part(seen, self.crop)
        height, width = seen.shape[0] // self.factor, seen.shape[1] // self.factor
        return seen.reshape(height, self.factor, width, self.factor).all(dim=3).all(dim=1)


def straight_picture(rgba: Tensor, places: Tensor) -> Tensor:
    """Undo a lens: (H, W, 4) straight alpha as a pinhole of the same focal lengths would show it.

    Sampled bilinearly on premultiplied colour; where the lens saw nothing, the border goes on.

    Args:
        rgba: (H, W, 4) straight alpha, through the lens.
        places: (H, W, 2) where each pixel comes from (`LensDistortion.sources`).
    """
    height, width = rgba.shape[:2]
    grid = 2 * places / torch.tensor([width, height]) - 1
    alpha = rgba[..., 3:]
    planes = torch.cat([rgba[..., :3] * alpha, alpha], dim=-1).permute(2, 0, 1)[None]
    found = F.grid_sample(planes, grid[None], padding_mode="border", align_corners=False)
    found = found[0].permute(1, 2, 0)
    covered = found[..., 3:]
    color = torch.where(covered > 0, found[..., :3] / covered.clamp_min(1e-12), 0.0)
    return torch.cat([color.clamp(0.0, 1.0), covered], dim=-1)


def _part(picture: Tensor, crop: Crop | None) -> Tensor:
    if crop is None:
        return picture
    left, top, right, bottom = crop
    return picture[top:bottom, left:right]


def area_downscale(rgba: Tensor, factor: int) -> Tensor:
    """Mean over factor x factor blocks, taken on premultiplied colour.

    Straight colours must not be averaged: what stands under alpha = 0 would bleed into the edge.

    Args:
        rgba: (H, W, 4) straight alpha.
        factor: whole number that divides H and W.

    Returns:
        (H / factor, W / factor, 4) straight alpha; colour is 0 where alpha is 0.
    """
    height, width = rgba.shape[:2]
    check_factor(width, height, factor)
    if factor == 1:
        return rgba
    alpha = rgba[..., 3:]
    solid = bool((alpha == 1.0).all())  # As most photos are: colours are premultiplied as they are.
    premultiplied = rgba if solid else torch.cat([rgba[..., :3] * alpha, alpha], dim=-1)
    blocks = premultiplied.reshape(height // factor, factor, width // factor, factor, 4)
    total = torch.zeros_like(blocks[:, 0, :, 0])
    for row in blocks.unbind(1):
        # Slice by slice: a mean over two axes takes five times as long.
        across = row[:, :, 0].clone()
        for column in range(1, factor):
            across += row[:, :, column]
        total += across
    mean = total / factor**2
    if solid:
        return mean.clamp_(0.0, 1.0)
    covered = mean[..., 3:]
    color = torch.where(covered > 0, mean[..., :3] / covered.clamp_min(1e-12), 0.0)
    return torch.cat([color.clamp(0.0, 1.0), covered], dim=-1)


def check_factor(width: int, height: int, factor: int) -> None:
    """Raise InputError when `factor` does not divide both sides, naming the factors that do."""
    check_count("down-scaling factor", factor)
    if width % factor or height % factor:
        smaller = min(width, height)
        good = [n for n in range(1, smaller + 1) if width % n == 0 and height % n == 0]
        raise InputError(
            f"down-scaling factor: {width} x {height} images cannot be divided by {factor}; "
            f"use one of {', '.join(map(str, good))}"
        )


def composite(rgba: Tensor, background: Tensor) -> Tensor:
    """Straight-alpha (..., 4) over `background` (3,): (..., 3). The only place that does this."""
    alpha = rgba[..., 3:]
    return rgba[..., :3] * alpha + background.to(rgba) * (1.0 - alpha)


def background_color(kind: str, generator: torch.Generator | None = None) -> Tensor:
    """Colour (3,) of a background.

    Args:
        kind: "white", "black" or "random" (drawn anew at every call).
        generator: source of the random colour; None takes torch's global one.
    """
    if kind == "white":
        return torch.ones(3)
    if kind == "black":
        return torch.zeros(3)
    if kind == "random":
        return torch.rand(3, generator=generator)
    raise InputError(f"background: expected white, black or random, got {kind!r}")

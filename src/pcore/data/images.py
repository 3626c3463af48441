"""Image files as float32 straight-alpha RGBA, down-scaled by area, decoded when they are needed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, UnidentifiedImageError
from torch import Tensor

from pcore.errors import InputError, SceneError
from pcore.validation import check_count

DEFAULT_MEMORY_BUDGET = 2 * 1024**3
_EIGHT_BIT_MODES = {"1", "L", "LA", "P", "PA", "RGB", "RGBA"}


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """What an image file says about itself before its pixels are decoded.

    Attributes:
        width: pixels.
        height: pixels.
        has_alpha: whether the file carries an alpha channel or a transparent colour.
    """

    width: int
    height: int
    has_alpha: bool


class ImageCache:
    """Decoded images, least recently used thrown out first; safe to share between threads.

    The budget bounds what is KEPT between calls. Images being decoded or handed out right now
    come on top of it; an image larger than the whole budget is handed out and not kept.
    """

    def __init__(self, memory_budget: int = DEFAULT_MEMORY_BUDGET) -> None:
        self.memory_budget = check_count("memory budget in bytes", memory_budget, minimum=0)
        self._images: OrderedDict[tuple[Path, int], Tensor] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    @property
    def bytes_used(self) -> int:
        """Bytes of all images kept now."""
        with self._lock:
            return self._bytes

    def get(self, key: tuple[Path, int], decode: Callable[[], Tensor]) -> Tensor:
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

    def _keep(self, key: tuple[Path, int], image: Tensor) -> None:
        size = image.numel() * image.element_size()
        with self._lock:
            if key in self._images or size > self.memory_budget:
                return
            while self._bytes + size > self.memory_budget:
                _, oldest = self._images.popitem(last=False)
                self._bytes -= oldest.numel() * oldest.element_size()
            self._images[key] = image
            self._bytes += size


@dataclass(frozen=True, kw_only=True)
class ImageSource:
    """One image file of a scene, decoded on request.

    Attributes:
        path: the file.
        header: the size it must have before down-scaling.
        factor: whole number by which both sides are divided.
        cache: shared by all views of a scene.
    """

    path: Path
    header: ImageHeader
    factor: int
    cache: ImageCache

    def rgba(self) -> Tensor:
        """(H, W, 4) float32 straight alpha in [0, 1]. Shared with the cache: do not write to it."""
        return self.cache.get((self.path, self.factor), self._decode)

    def _decode(self) -> Tensor:
        rgba = read_rgba(self.path, size=(self.header.width, self.header.height))
        return area_downscale(rgba, self.factor)


def read_header(path: Path) -> ImageHeader:
    """Size and channels of an image file without decoding it; SceneError when it has none."""
    try:
        with Image.open(path) as image:
            _check_mode(path, image.mode)
            return ImageHeader(
                width=image.width, height=image.height, has_alpha=image.has_transparency_data
            )
    except FileNotFoundError:
        raise SceneError(
            f"image {path}: no such file; put it there or remove its frame from the scene file"
        ) from None
    except UnidentifiedImageError:
        raise SceneError(
            f"image {path}: expected an image such as PNG, got a file of another kind or a "
            "damaged header; export it again"
        ) from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as problem:
        raise SceneError(f"image {path}: cannot be opened ({problem})") from problem


def read_rgba(path: Path, *, size: tuple[int, int] | None = None) -> Tensor:
    """Decode an 8-bit image file.

    Args:
        path: PNG or any other format that Pillow reads.
        size: (width, height) that the image must have; None takes any.

    Returns:
        (H, W, 4) float32 straight alpha in [0, 1]; alpha is 1 where the file has none.
    """
    header = read_header(path)
    if size is not None and (header.width, header.height) != size:
        raise SceneError(
            f"image {path}: expected {size[0]} x {size[1]} pixels, "
            f"got {header.width} x {header.height}; all images of a scene must have one size"
        )
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGBA"), dtype=np.float32)
    except (OSError, SyntaxError, ValueError) as problem:
        raise SceneError(
            f"image {path}: expected {header.width} x {header.height} pixels, got a truncated or "
            f"damaged file ({problem}); copy or export it again"
        ) from problem
    return torch.from_numpy(pixels / 255.0)


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
    premultiplied = torch.cat([rgba[..., :3] * alpha, alpha], dim=-1)
    blocks = premultiplied.reshape(height // factor, factor, width // factor, factor, 4)
    mean = blocks.mean(dim=(1, 3))
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


def _check_mode(path: Path, mode: str) -> None:
    if mode not in _EIGHT_BIT_MODES:
        raise SceneError(
            f"image {path}: expected 8 bits per channel (RGB or RGBA), got pixels of kind "
            f"{mode!r}; convert it to 8-bit PNG"
        )

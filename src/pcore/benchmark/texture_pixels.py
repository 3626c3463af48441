"""Pixels of the pictures that a model is painted with."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from pcore.errors import InputError

_MOST_PIXELS = 2**26
"""Of a texture: 8192 x 8192."""
_SIXTEEN_BITS = 257.0
"""Steps of 16 bits in one of 8."""


def texture_pixels(content: bytes, where: str) -> NDArray[np.uint8]:
    """Decode a PNG, JPEG or WebP of any depth, palette or grey: (H, W, 4) sRGB, straight alpha.

    Raises:
        InputError: another format, damaged, or too large.
    """
    try:
        with Image.open(io.BytesIO(content)) as opened:
            if opened.width * opened.height <= _MOST_PIXELS:
                return _rgba(opened)
            size = f"{opened.width} x {opened.height}"
    except (UnidentifiedImageError, OSError, ValueError, Image.DecompressionBombError):
        raise InputError(
            f"{where}: expected a texture in PNG, JPEG or WebP, got one that cannot be read; "
            "export it again"
        ) from None
    raise InputError(
        f"{where}: expected textures of at most {_MOST_PIXELS:,} pixels, got {size}; make it "
        "smaller"
    )


def _rgba(opened: Image.Image) -> NDArray[np.uint8]:
    if not opened.mode.startswith("I"):
        return np.asarray(opened.convert("RGBA"))
    # Grey of 16 bits, which Pillow would cut off at 255.
    grey = np.rint(np.asarray(opened, dtype=np.float64) / _SIXTEEN_BITS).astype(np.uint8)
    return np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=-1)

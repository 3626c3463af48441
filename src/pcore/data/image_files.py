"""Image files and masks: what their headers say, and their pixels."""

from __future__ import annotations

import importlib
import importlib.util
import struct
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError
from torch import Tensor

from pcore.errors import SceneError

_EIGHT_BIT_MODES = {"1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr", "LAB", "HSV"}
_SIXTEEN_BIT_MODES = {"I;16", "I;16B", "I;16L", "I;16N", "I"}
"""Grey of 16 bits; Pillow gives that of some formats as numbers of 32 bits."""
_WHITE = 65535
_HEIC = (b"ftypheic", b"ftypheix", b"ftyphevc", b"ftypheim", b"ftypheis", b"ftypmif1")
"""How files of HEIC begin after four bytes; endings may say anything."""


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """What an image file says about itself before its pixels are decoded.

    Attributes:
        width: pixels, as they are stored.
        height: pixels.
        has_alpha: whether the file carries an alpha channel or a transparent colour.
        orientation: its EXIF tag: how viewers turn the stored pixels, from 1 (not at all) to 8.
    """

    width: int
    height: int
    has_alpha: bool
    orientation: int = 1

    @property
    def upright_size(self) -> tuple[int, int]:
        """(width, height) after turning as the EXIF tag says."""
        swapped = self.orientation > 4
        return (self.height, self.width) if swapped else (self.width, self.height)


def read_header(path: Path) -> ImageHeader:
    """Size and channels of an image file without decoding it; SceneError when it has none."""
    if _is_heic(path):
        _register_heic()
    try:
        with Image.open(path) as image:
            _check_mode(path, image.mode)
            return ImageHeader(
                width=image.width,
                height=image.height,
                has_alpha=image.has_transparency_data,
                orientation=_orientation(image),
            )
    except FileNotFoundError:
        raise SceneError(
            f"image {path}: no such file; put it there or remove its frame from the scene file"
        ) from None
    except UnidentifiedImageError:
        if _is_heic(path):
            raise SceneError(
                f"image {path}: HEIC is read with Pillow's plug-in, which is not installed: "
                "`pip install pillow-heif`, or export the photos as JPEG"
            ) from None
        raise SceneError(
            f"image {path}: expected an image such as PNG, got a file of another kind or a "
            "damaged header; export it again"
        ) from None
    except Image.DecompressionBombError as problem:
        raise SceneError(
            f"image {path}: expected a photo, got more pixels than any camera takes; is it the "
            "right file?"
        ) from problem
    except (OSError, SyntaxError, ValueError) as problem:
        raise SceneError(f"image {path}: cannot be opened ({problem})") from problem


def read_rgba(path: Path, *, size: tuple[int, int] | None = None, upright: bool = False) -> Tensor:
    """Decode an image file: colours of 8 bits (palette, grey, CMYK too) or grey of 16.

    Args:
        path: PNG or any other format that Pillow reads (JPEG, WebP, AVIF, TIFF; HEIC with its
            plug-in).
        size: (width, height) that the stored pixels must have; None takes any.
        upright: turn the pixels as the EXIF tag says.

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
            turned = ImageOps.exif_transpose(image) if upright else image
            if image.mode in _SIXTEEN_BIT_MODES:
                return _grey(np.asarray(turned, dtype=np.float32), path)
            if image.mode in ("LAB", "HSV", "YCbCr", "CMYK"):
                turned = turned.convert("RGB")
            pixels = torch.from_numpy(np.array(turned.convert("RGBA")))
    except (OSError, SyntaxError, ValueError) as problem:
        raise SceneError(
            f"image {path}: expected {header.width} x {header.height} pixels, got a truncated or "
            f"damaged file ({problem}); copy or export it again"
        ) from problem
    return pixels.float().div_(255.0)


def _grey(pixels: NDArray[np.float32], path: Path) -> Tensor:
    """(H, W, 4) of grey (H, W) between 0 and 65535."""
    if pixels.min() < 0 or pixels.max() > _WHITE:
        raise SceneError(
            f"image {path}: expected grey of 16 bits, got values between {pixels.min():g} and "
            f"{pixels.max():g}; convert it to 8-bit PNG"
        )
    grey = torch.from_numpy(pixels / _WHITE).unsqueeze(-1)
    return torch.cat([grey, grey, grey, torch.ones_like(grey)], dim=-1)


def read_mask(path: Path, *, size: tuple[int, int]) -> Tensor:
    """Decode a mask: bright is object, black is background.

    A mask of two values, of which one is 0, may write the other one as it likes (1 or 255). One for
    a larger or smaller copy of the image is scaled (mean of areas).

    Args:
        path: an 8-bit image; what is transparent is background.
        size: (width, height) of the image that it belongs to.

    Returns:
        (H, W) float32 in [0, 1].

    Raises:
        SceneError: missing, damaged or of another shape.
    """
    header = read_header(path)
    stored = header.width, header.height
    if stored != size and not _is_scaled(stored, size):
        raise SceneError(
            f"mask {path}: expected {size[0]} x {size[1]} pixels as its image has, got "
            f"{header.width} x {header.height}; write it in the size of the image, or scaled evenly"
        )
    rgba = read_rgba(path)
    mask = rgba[..., :3].amax(dim=-1) * rgba[..., 3]
    brightest = mask.max()
    two_values = bool(((mask == 0) | (mask == brightest)).all())
    mask = (mask > 0).float() if two_values else mask
    if stored == size:
        return mask
    return F.interpolate(mask[None, None], (size[1], size[0]), mode="area")[0, 0]


def _is_scaled(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether a picture is larger or smaller than another along both sides by the same factor.

    Sides were rounded to whole pixels.
    """
    (width, height), (w, h) = size, other
    if (width < w) != (height < h) or (width > w) != (height > h):
        return False
    return abs(width * h - height * w) <= max(*size, *other)


def _is_heic(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(12)[4:] in _HEIC
    except OSError:
        return False  # It is told what is wrong with it when it is opened.


@cache
def _register_heic() -> None:
    """Let Pillow read HEIC where the plug-in is installed."""
    if importlib.util.find_spec("pillow_heif") is not None:
        importlib.import_module("pillow_heif").register_heif_opener()


def _orientation(image: Image.Image) -> int:
    """EXIF orientation, 1 to 8. Pillow turns TIFF files by itself."""
    # Not image.getexif(): that decodes all of a PNG file.
    content = image.info.get("exif")
    if image.format == "TIFF" or not isinstance(content, bytes):
        return 1
    exif = Image.Exif()
    try:
        exif.load(content)
    except (OSError, SyntaxError, ValueError, KeyError, struct.error):
        return 1  # A damaged tag turns no image in any viewer.
    found = exif.get(ExifTags.Base.Orientation, 1)
    return found if isinstance(found, int) and 1 <= found <= 8 else 1


def _check_mode(path: Path, mode: str) -> None:
    if mode not in _EIGHT_BIT_MODES | _SIXTEEN_BIT_MODES:
        raise SceneError(
            f"image {path}: expected 8 bits per channel, or grey of 16, got pixels of kind "
            f"{mode!r}; convert it to 8-bit PNG"
        )

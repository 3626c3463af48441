"""Pictures as files: PNG for looking at, `.npz` for computing; depth and normals in colours."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pcore.data.whole_file import replace_file
from pcore.errors import InputError
from pcore.geometry.camera import Camera

# Lightness, chroma and hue (degrees) of the near and the far end in Oklab's polar form: the map
# gets evenly darker and never as bright as the white that stands for "nothing there".
_NEAR, _FAR = (0.90, 0.13, 100.0), (0.28, 0.09, 300.0)
_COLORS = 256
_MAX_SIDE = 65500


def to_bytes(rgb: Tensor) -> Tensor:
    """Return colours (..., 3) as uint8: clamped to [0, 1], rounded to the nearest of 256 levels."""
    return (rgb.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8)


def write_png(path: Path, rgb: Tensor) -> None:
    """Write colours (H, W, 3), float in [0, 1] (clamped) or uint8, as an 8-bit PNG.

    Raises:
        InputError: not a picture, or NaN in it.
        OSError: the file cannot be written; an old one is untouched.
    """
    _check_picture(path, rgb)
    replace_file(path, png_content(rgb))


def png_content(rgb: Tensor) -> bytes:
    """Content of an 8-bit PNG of colours (H, W, 3 or 4), float in [0, 1] (clamped) or uint8."""
    pixels = rgb.cpu() if rgb.dtype == torch.uint8 else to_bytes(rgb)
    buffer = io.BytesIO()
    Image.fromarray(pixels.numpy()).save(buffer, format="PNG")
    return buffer.getvalue()


def linear_colors(rgb: Tensor) -> Tensor:
    """Linear colours of sRGB ones (..., 3) in [0, 1], as glTF and USD want them at vertices."""
    return torch.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def write_rgba(path: Path, rgb: Tensor, alpha: Tensor) -> None:
    """Write colours that were taken over black, with opacity, as a PNG of straight alpha.

    Args:
        path: the file.
        rgb: (H, W, 3) over black.
        alpha: (H, W).

    Raises:
        InputError: not a picture, or NaN in it.
        OSError: the file cannot be written; an old one is untouched.
    """
    _check_picture(path, rgb)
    opacity = alpha.detach().cpu().clamp(0, 1).unsqueeze(-1)
    straight = torch.where(opacity > 0, rgb.detach().cpu() / opacity.clamp_min(1e-6), 0.0)
    pixels = to_bytes(torch.cat([straight, opacity], dim=-1))
    buffer = io.BytesIO()
    Image.fromarray(pixels.numpy()).save(buffer, format="PNG")
    replace_file(path, buffer.getvalue())


def write_mask(path: Path, mask: Tensor) -> None:
    """Write a mask (H, W) in [0, 1] as a grey 8-bit PNG; the file appears whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    levels = (255 * mask.detach().cpu().clamp(0.0, 1.0)).round().byte().numpy()
    stream = io.BytesIO()
    Image.fromarray(levels).save(stream, format="PNG")
    replace_file(path, stream.getvalue())


def write_photo(path: Path, rgba: Tensor, *, opaque: bool) -> None:
    """Write a picture (H, W, 4), straight alpha in [0, 1], as an 8-bit PNG; no alpha if opaque.

    Raises:
        OSError: it cannot be written.
    """
    stream = io.BytesIO()
    pixels = to_bytes(rgba[..., :3] if opaque else rgba).numpy()
    Image.fromarray(pixels).save(stream, format="PNG")
    replace_file(path, stream.getvalue())


def write_raw(path: Path, **arrays: Tensor) -> None:
    """Write named arrays, such as `rgb`, `alpha`, `depth` and `surface`, as float32 in an `.npz`.

    Nothing is clamped and NaN stays NaN.

    Raises:
        OSError: the file cannot be written; an old one is untouched.
    """
    buffer = io.BytesIO()
    plain = {name: value.detach().cpu().float().numpy() for name, value in arrays.items()}
    np.savez_compressed(buffer, allow_pickle=False, **plain)
    replace_file(path, buffer.getvalue())


def depth_picture(depth: Tensor, alpha: Tensor, *, near: float, far: float) -> Tensor:
    """Depth as colours (H, W, 3) in [0, 1]: near is bright yellow, far dark violet, none white.

    Args:
        depth: (H, W) camera z; NaN counts as nothing.
        alpha: (H, W) opacity; the colours fade to white with it.
        near: depth of the bright end, world units.
        far: depth of the dark end; take one range for all pictures that are compared.

    Raises:
        InputError: `near` is not below `far`.
    """
    if not near < far:
        raise InputError(f"depth picture: expected near < far, got {near} and {far}")
    share = ((depth - near) / (far - near)).clamp(0, 1).nan_to_num(0.0)
    colors = _depth_colors()[(share * (_COLORS - 1)).round().long()]
    opacity = torch.where(depth.isnan(), 0.0, alpha.clamp(0, 1)).unsqueeze(-1)
    return colors * opacity + (1 - opacity)


def depth_range(points: Tensor, cameras: Sequence[Camera]) -> tuple[float, float]:
    """Return near and far for `depth_picture`: one range for all pictures of these points.

    Args:
        points: (N, 3) world units; the outermost hundredth on either side is left out, because a
            learned cloud has strays.
        cameras: at least one.
    """
    shares = torch.tensor([0.01, 0.99])
    positions = points.detach().cpu().float()
    ends = torch.stack([torch.quantile(camera.depth(positions), shares) for camera in cameras])
    near, far = float(ends[:, 0].min()), float(ends[:, 1].max())
    # A single point, or a flat cloud seen from the front, has no range of its own.
    slack = 0.0 if far > near else max(abs(near), 1.0) * 0.01
    return near - slack, far + slack


def normal_picture(normals: Tensor, world_from_camera: Tensor) -> Tensor:
    """Normals as colours (H, W, 3) in [0, 1]: right is red, up green, towards the camera blue.

    Args:
        normals: (H, W, 3) unit length, world axes; NaN is shown white.
        world_from_camera: (4, 4) pose of the camera that sees them.
    """
    in_camera = normals @ world_from_camera[:3, :3].to(normals)
    return ((in_camera + 1) / 2).nan_to_num(1.0)


def _check_picture(path: Path, rgb: Tensor) -> None:
    shape = tuple(rgb.shape)
    if len(shape) != 3 or shape[2] != 3 or not 0 < min(shape[:2]) <= max(shape[:2]) <= _MAX_SIDE:
        raise InputError(f"{path}: expected a picture (H, W, 3), got the shape {shape}")
    if rgb.is_floating_point() and bool(rgb.isnan().any()):
        raise InputError(f"{path}: expected colours, got NaN; is the model damaged?")


def _depth_colors() -> Tensor:
    """(256, 3) sRGB from near to far: lightness and hue change evenly (Oklab)."""
    share = torch.linspace(0, 1, _COLORS)
    lightness, chroma, hue = (a + share * (b - a) for a, b in zip(_NEAR, _FAR, strict=True))
    turn = torch.deg2rad(hue)
    oklab = torch.stack([lightness, chroma * torch.cos(turn), chroma * torch.sin(turn)], dim=-1)
    cones = (oklab @ _CONES_FROM_OKLAB.T) ** 3
    linear = (cones @ _LINEAR_FROM_CONES.T).clamp(0, 1)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


# Ottosson, "A perceptual color space for image processing" (2020).
_CONES_FROM_OKLAB = torch.tensor(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_LINEAR_FROM_CONES = torch.tensor(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)

"""Pictures for people: colours on white, depth maps, and sheets with labels."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pcore.data.pictures import depth_picture, to_bytes
from pcore.errors import InputError
from pcore.evaluation.protocol import on_white
from pcore.metrics.geometry_metrics import COVERED_ALPHA
from pcore.metrics.image_metrics import Array, as_array, as_plane_or_image

Pixels = NDArray[np.uint8]
"""(H, W, 3) sRGB."""
Range = tuple[float, float]

_INK, _PAPER = (32, 33, 36), (255, 255, 255)
_LETTER = 15
"""Height of the letters of a legend, pixels."""


def color_pixels(rgb: Array) -> Pixels:
    """Colours (H, W, 3), clamped to [0, 1] and rounded to 8 bits."""
    return _eight_bits(as_array("colours", rgb, 3))


def truth_pixels(rgba: Array) -> Pixels:
    """A true image (H, W, 4), straight alpha, on white."""
    return _eight_bits(on_white(as_array("true image", rgba, 4)))


def depth_range(depths: Sequence[tuple[Array, Array]]) -> Range | None:
    """Nearest and farthest depth over covered pixels of (alpha, depth) maps; None without any.

    A depth map's rare outliers would take the contrast from all the rest: the range leaves out
    one percent at either end.
    """
    values = [
        d[np.isfinite(d) & (a >= COVERED_ALPHA)]
        for a, d in ((_plane(alpha), _plane(depth)) for alpha, depth in depths)
    ]
    known = np.concatenate(values) if values else np.zeros(0)
    if known.size == 0:
        return None
    low, high = np.percentile(known, (1.0, 99.0))
    return float(low), float(max(high, low + 1e-6))


def depth_pixels(alpha: Array, depth: Array, span: Range | None) -> Pixels:
    """A depth map (H, W) in colours that fade to white with the opacity.

    Args:
        alpha: (H, W) opacity.
        depth: (H, W) camera z; white where it is not finite.
        span: depths of the first and the last colour; None when nothing is covered anywhere.
    """
    distance, opacity = (torch.from_numpy(_plane(one)).float() for one in (depth, alpha))
    if span is None:
        return np.full((*distance.shape, 3), 255, dtype=np.uint8)
    # Infinity is how the truth says "nothing there"; a rendering says NaN.
    distance = distance.masked_fill(~distance.isfinite(), torch.nan)
    colors = depth_picture(distance, opacity, near=span[0], far=span[1])
    return np.asarray(to_bytes(colors).numpy(), dtype=np.uint8)


def sheet(
    columns: Sequence[str], rows: Sequence[tuple[str, Sequence[Pixels | None]]], *, cell: int = 220
) -> Pixels:
    """Lay pictures out in a grid with a title above every column and beside every row.

    Args:
        columns: titles of the columns.
        rows: title and pictures of every row, one per column; None leaves its place empty.
        cell: longer side of every picture on the sheet, pixels.

    Raises:
        InputError: a row has another number of pictures than there are columns, or there is none.
    """
    pictures = [p for _, row in rows for p in row if p is not None]
    if not pictures or any(len(row) != len(columns) for _, row in rows):
        raise InputError(
            f"figure: expected {len(columns)} pictures in every row, got "
            f"{', '.join(str(len(row)) for _, row in rows) or 'no rows'}"
        )
    tallest = max(p.shape[0] / p.shape[1] for p in pictures)
    width, height = (cell, round(cell * tallest)) if tallest <= 1 else (round(cell / tallest), cell)
    # 10.1 is Pillow's first version whose own font has sizes.
    font: Any = ImageFont.load_default(size=max(11.0, cell / 13))
    line, gap = round(max(11.0, cell / 13) * 1.7), max(2, cell // 55)
    size = (line + len(columns) * (width + gap), line + len(rows) * (height + gap))
    page = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(page)
    for i, title in enumerate(columns):
        middle = line + i * (width + gap) + width / 2
        draw.text((middle, line / 2), title, fill=_INK, font=font, anchor="mm")
    for j, (title, row) in enumerate(rows):
        top = line + j * (height + gap)
        _write_upwards(page, title, font, (line, height), top)
        for i, picture in enumerate(row):
            if picture is not None:
                scaled = Image.fromarray(picture).resize((width, height), Image.Resampling.BICUBIC)
                page.paste(scaled, (line + i * (width + gap), top))
    return np.asarray(page, dtype=np.uint8)


def with_legend(
    page: Pixels, lines: Mapping[str, Sequence[tuple[str, tuple[float, float, float]]]]
) -> Pixels:
    """Write under a page what its colours mean.

    Args:
        page: the pictures.
        lines: title of a column -> what each of its colours (sRGB, 0 to 1) means.
    """
    font: Any = ImageFont.load_default(size=_LETTER)
    width, line = page.shape[1], 2 * _LETTER
    placed: list[tuple[float, int, str, str, tuple[float, float, float]]] = []
    row = 0
    for title, colors in lines.items():
        x, row = float(_LETTER), row + 1
        for number, (words, color) in enumerate(colors):
            own = f"{title}:  " if number == 0 else ""
            length = float(font.getlength(own)) + line + float(font.getlength(words))
            if x > _LETTER and x + length > width:
                x, row = float(_LETTER), row + 1
            placed.append((x, row - 1, own, words, color))
            x += length + _LETTER
    strip = Image.new("RGB", (width, line * row), _PAPER)
    draw = ImageDraw.Draw(strip)
    for x, at, own, words, color in placed:
        middle = (at + 0.5) * line
        draw.text((x, middle), own, fill=_INK, font=font, anchor="lm")
        left = x + float(font.getlength(own))
        corners = (left, middle - _LETTER / 2, left + _LETTER, middle + _LETTER / 2)
        draw.rectangle(corners, fill=tuple(round(255 * part) for part in color))
        draw.text((left + 1.5 * _LETTER, middle), words, fill=_INK, font=font, anchor="lm")
    return np.concatenate([page, np.asarray(strip, dtype=np.uint8)])


def png_bytes(pixels: Pixels) -> bytes:
    """(H, W, 3) pixels as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def data_uri(content: bytes, mime: str) -> str:
    """Content as an address that carries it, for pages without other files."""
    return f"data:{mime};base64,{base64.b64encode(content).decode('ascii')}"


def _write_upwards(page: Any, text: str, font: Any, size: tuple[int, int], top: int) -> None:
    width, height = size
    strip = Image.new("RGB", (height, width), _PAPER)
    middle = (height / 2, width / 2)
    ImageDraw.Draw(strip).text(middle, text, fill=_INK, font=font, anchor="mm")
    page.paste(strip.transpose(Image.Transpose.ROTATE_90), (0, top))


def _eight_bits(image: NDArray[np.float64]) -> Pixels:
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)


def _plane(value: Array) -> NDArray[np.float64]:
    return as_plane_or_image("depth map", value, None)

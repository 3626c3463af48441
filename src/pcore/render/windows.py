"""Tiles of a picture: what the UNet sees of it at once, and what is kept of that."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torch import Tensor

from pcore.model.unet import ALIGNMENT, RECEPTIVE_MARGIN
from pcore.render.raster import Raster

Slices = tuple[slice, slice]
Window = tuple[Slices, Slices, Slices]
"""One tile: what is seen of the image with its surroundings, what is kept of that, and where the
kept part lies in the image."""


def windows(raster: Raster) -> Iterator[Window]:
    """Tiles of a picture, row by row."""
    tile, margin = raster.tile, raster.margin
    for top in range(0, raster.size[0], tile):
        for left in range(0, raster.size[1], tile):
            starts = zip((top, left), raster.size, strict=True)
            rows, columns = (_span(start, tile, margin, end) for start, end in starts)
            seen, trimmed, kept = zip(rows, columns, strict=True)
            yield seen, trimmed, kept


def rows_in_use(raster: Raster, chunk: int) -> int:
    """Rows of features that are held when chunks of pixels come in from above, tile after tile.

    Those that a tile sees, and those that a chunk reaches beyond them.
    """
    return raster.tile + 2 * raster.margin + math.ceil(chunk / raster.size[1])


def _span(start: int, tile: int, margin: int, end: int) -> tuple[slice, slice, slice]:
    """Seen, trimmed and kept part along one axis."""
    stop = min(start + tile, end)
    first = max(0, start - margin)
    last = min(end, stop + margin)
    return slice(first, last), slice(start - first, stop - first), slice(start, stop)


def shown_part(alpha: Tensor, window: Window, step: int) -> Window | None:
    """The part of a tile where anything is to be seen, on the UNet's grid; None: nowhere.

    Elsewhere opacity is 0, and the background shows whatever the UNet would say.

    Args:
        alpha: (H, W) opacity of all that the tile keeps.
        window: the tile.
        step: pixels between those that the UNet sees beside each other (`Raster`).
    """
    inside, _, kept = window
    opaque = alpha[kept].detach() > 0
    grid, margin = ALIGNMENT * step, RECEPTIVE_MARGIN * step
    spans: list[tuple[slice, slice, slice]] = []
    for axis, (seen, whole) in enumerate(zip(inside, kept, strict=True)):
        met = opaque.any(dim=1 - axis).nonzero().flatten()
        if not len(met):
            return None
        # Tiles begin on the grid.
        first = whole.start + int(met[0]) // grid * grid
        last = min(whole.stop, whole.start + (int(met[-1]) // grid + 1) * grid)
        around = slice(max(seen.start, first - margin), min(seen.stop, last + margin))
        trimmed = slice(first - around.start, last - around.start)
        spans.append((around, trimmed, slice(first, last)))
    rows, columns = spans
    return (rows[0], columns[0]), (rows[1], columns[1]), (rows[2], columns[2])

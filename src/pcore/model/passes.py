"""What pictures are made of: attention of rays in chunks, colours in tiles.

Attention looks at every ray by itself; the UNet looks some pixels around (`Raster`), so a tile
is computed with that much of its surroundings, cut where the pooling grid of the whole image lies,
and then trimmed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr, averaged
from pcore.model.raster import Raster
from pcore.model.surface import middle_surface, surface_of
from pcore.model.unet import ALIGNMENT

Progress = Callable[[float], None]


class RenderCancelledError(PcoreError):
    """The caller asked a running `render` to stop; there is no picture."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One rendered view; float32 on the CPU, world units.

    Attributes:
        rgb: (H, W, 3) colours over the model's background, not clamped.
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) camera z of the surface; NaN where a ray has no attention at all.
        surface: (H, W, 3) predicted surface points; NaN where a ray has no attention at all.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    surface: Tensor


Slices = tuple[slice, slice]


@dataclass(frozen=True, kw_only=True)
class Window:
    """One tile: `seen` with its surroundings, `trimmed` inside of that, `kept` in the image."""

    seen: Slices
    trimmed: Slices
    kept: Slices


def windows(raster: Raster) -> Iterator[Window]:
    """Tiles of a picture, row by row."""
    tile, margin = raster.tile, raster.margin
    for top in range(0, raster.size[0], tile):
        for left in range(0, raster.size[1], tile):
            starts = zip((top, left), raster.size, strict=True)
            spans = [_span(start, tile, margin, end) for start, end in starts]
            seen, trimmed, kept = zip(*spans, strict=True)
            yield Window(seen=seen, trimmed=trimmed, kept=kept)


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


class Steps:
    """Counts chunks of work and talks to the caller between them."""

    def __init__(
        self, total: int, cancel: Callable[[], bool] | None, progress: Progress | None
    ) -> None:
        self._total = total
        self._count = 0
        self._cancel = cancel
        self._progress = progress

    def check(self) -> None:
        """Raise RenderCancelledError when the caller says so."""
        if self._cancel is not None and self._cancel():
            raise RenderCancelledError("the rendering was cancelled before it was complete")

    def done(self) -> None:
        """Count one chunk."""
        self._count += 1
        if self._progress is not None:
            self._progress(self._count / self._total)


@dataclass(frozen=True, kw_only=True)
class Canvas:
    """A picture that fills up.

    Attributes:
        features: (rows, W, C) on the model's device: row i of the picture lies at i modulo rows,
            so that later rows take the place of those that no tile needs any more.
        alpha: (H, W) on the model's device.
        gain: (H, W) on the model's device, factor on the object's brightness; 1 at first.
        surface: (H, W, 3) on the CPU.
        rgb: (H, W, 3) on the CPU.
    """

    features: Tensor
    alpha: Tensor
    gain: Tensor
    surface: Tensor
    rgb: Tensor

    @classmethod
    def blank(cls, papr: Papr, size: tuple[int, int], rows: int | None = None) -> Canvas:
        """Room for a picture (H, W) of a model, and for so many rows of its features; None: all."""
        device, channels = next(papr.parameters()).device, papr.config.value.size
        return cls(
            features=torch.empty(min(rows or size[0], size[0]), size[1], channels, device=device),
            alpha=torch.empty(size, device=device),
            gain=torch.ones(size, device=device),
            surface=torch.empty(*size, 3),
            rgb=torch.empty(*size, 3),
        )

    def picture(self, camera: Camera) -> Picture:
        """Return what is there as a picture that a camera took."""
        depth = camera.depth(self.surface)
        return Picture(rgb=self.rgb, alpha=self.alpha.cpu(), depth=depth, surface=self.surface)


def attend(
    canvas: Canvas,
    papr: Papr,
    cloud: PointCloud,
    rays: RayBundle,
    wanted: Tensor,
    threshold: float,
) -> None:
    """Fill M wanted pixels, given by their numbers, with what their rays meet, (M, S) of them."""
    device, shape = canvas.alpha.device, rays.shape
    sent = rays.to(device)
    attended, neighbours = papr.attend(cloud, sent, threshold)
    met = surface_of(cloud, sent.flat(), attended, neighbours, papr.config.cutoff)
    pixels = averaged(attended, met.gains, shape[1])
    rows, width, channels = canvas.features.shape
    there = wanted.to(device)
    canvas.features.view(-1, channels)[there % (rows * width)] = pixels.features
    canvas.alpha.view(-1)[there] = pixels.alpha
    if pixels.gain is not None:
        canvas.gain.view(-1)[there] = pixels.gain
    surface = met.surface.cpu().reshape(*shape, 3)
    canvas.surface.view(-1, 3)[wanted] = middle_surface(surface, rays.origins)


def shade(canvas: Canvas, papr: Papr, window: Window, step: int) -> None:
    """Fill the colours of a tile whose surroundings are attended to.

    Args:
        canvas: with features, opacity and gain of all that the tile sees.
        papr: the networks.
        window: the tile.
        step: pixels between those that the UNet sees beside each other (`Raster`).
    """
    seen, columns = window.seen
    rows = torch.arange(seen.start, seen.stop, device=canvas.alpha.device) % len(canvas.features)
    features = canvas.features[:, columns].index_select(0, rows)
    alpha, gain = canvas.alpha[window.seen], canvas.gain[window.seen]
    if step == 1:
        colours = papr.shade(features, alpha, gain=gain)
    else:
        colours = _laced(papr, features, alpha, gain, step)
    canvas.rgb[window.kept] = colours[window.trimmed].cpu()


def _laced(papr: Papr, features: Tensor, alpha: Tensor, gain: Tensor, step: int) -> Tensor:
    """Colours (H, W, 3) of lattices of every so-manieth pixel, one by one.

    The UNet knows zeros beyond the rim of a picture, one pixel of the photos wide. Of a lattice
    they would be a frame of many pixels, so the rim is repeated beyond itself first.
    """
    rim = ALIGNMENT * step
    planes = torch.cat([features, alpha.unsqueeze(-1), gain.unsqueeze(-1)], dim=-1)
    planes = F.pad(planes.permute(2, 0, 1).unsqueeze(0), (rim, rim, rim, rim), mode="replicate")
    planes = planes[0].permute(1, 2, 0)
    # A pixel of the photos is as wide as a step: so is the mean of what the UNet sees.
    features, alpha, gain = mean_around(planes[..., :-2], step), planes[..., -2], planes[..., -1]
    colours = alpha.new_empty(*alpha.shape, 3)
    for row, column in product(range(step), repeat=2):
        lattice = (slice(row, None, step), slice(column, None, step))
        colours[lattice] = papr.shade(features[lattice], alpha[lattice], gain=gain[lattice])
    return colours[rim:-rim, rim:-rim]


def mean_around(features: Tensor, width: int) -> Tensor:
    """Means (H, W, C) over squares of so many pixels around every pixel, zeros beyond the rim.

    Where the number is even the outermost pixels of a square count half.
    """
    reach = width // 2
    weights = features.new_ones(2 * reach + 1)
    if width % 2 == 0:
        weights[[0, -1]] = 0.5
    weights = weights / width
    planes = features.permute(2, 0, 1).unsqueeze(1)
    planes = F.conv2d(planes, weights.reshape(1, 1, -1, 1), padding=(reach, 0))
    planes = F.conv2d(planes, weights.reshape(1, 1, 1, -1), padding=(0, reach))
    return planes.squeeze(1).permute(1, 2, 0)


def pooled(picture: Picture, pool: int, camera: Camera) -> Picture:
    """Average squares of pixels; the surface is that of the pixel of the middle distance.

    Args:
        picture: `pool` times as large as that of the camera.
        pool: side of the squares.
        camera: of the result.
    """
    if pool == 1:
        return picture

    def squares(values: Tensor) -> Tensor:
        blocks = values.unflatten(1, (-1, pool)).unflatten(0, (-1, pool))
        return blocks.transpose(1, 2).flatten(2, 3)

    surface = squares(picture.surface).flatten(0, 1)
    origins = camera.center.to(surface).expand_as(surface)
    middle = middle_surface(surface, origins).unflatten(0, (camera.height, camera.width))
    return Picture(
        rgb=squares(picture.rgb).mean(dim=2),
        alpha=squares(picture.alpha).mean(dim=2),
        depth=camera.depth(middle),
        surface=middle,
    )

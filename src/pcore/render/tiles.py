"""What pictures are made of: rays traced in chunks, colours in tiles.

Attention looks at every ray by itself; the UNet looks some pixels around (`Raster`), so a tile
is computed with that much of its surroundings, cut where the pooling grid of the whole image lies,
and then trimmed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.hits import Hits
from pcore.model.papr import Papr, constant
from pcore.model.unet import ALIGNMENT
from pcore.render.image import Image
from pcore.render.raster import Raster
from pcore.render.reachable import reachable
from pcore.render.surface import middle_surface, surface_of
from pcore.render.trace import trace
from pcore.render.windows import Window, shown_part, windows

_LEAST_OPACITY = 1e-6


@dataclass(frozen=True, kw_only=True)
class Canvas:
    """A picture that fills up; on the model's device, of its dtype.

    Attributes:
        features: (rows, W, C): row i of the picture lies at i modulo rows, so that later rows take
            the place of those that no tile needs any more.
        alpha: (H, W).
        gain: (H, W) factor on the object's brightness; 1 at first.
        surface: (H, W, 3).
        rgb: (H, W, 3).
    """

    features: Tensor
    alpha: Tensor
    gain: Tensor
    surface: Tensor
    rgb: Tensor

    @classmethod
    def blank(cls, papr: Papr, size: tuple[int, int], rows: int | None = None) -> Canvas:
        """Room for a picture (H, W) of a model, and for so many rows of its features; None: all."""
        like, channels = next(papr.parameters()).detach(), papr.config.value.size
        return cls(
            features=like.new_empty(min(rows or size[0], size[0]), size[1], channels),
            alpha=like.new_empty(size),
            gain=like.new_ones(size),
            surface=like.new_empty(*size, 3),
            rgb=like.new_empty(*size, 3),
        )

    def image(self, camera: Camera) -> Image:
        """Return what is there as a picture that a camera took."""
        depth = camera.depth(self.surface)
        return Image(rgb=self.rgb, alpha=self.alpha, depth=depth, surface=self.surface)


def paint(
    canvas: Canvas, papr: Papr, posed: PosedCloud, raster: Raster, chunk: int, threshold: float
) -> Iterator[int]:
    """Fill a canvas from above; yield the number of its complete rows after every chunk and tile.

    Args:
        canvas: of the raster's size.
        papr: the networks.
        posed: the points, on the device of the networks.
        raster: how the picture is sampled.
        chunk: pixels traced at once.
        threshold: as `trace` has it.
    """
    height, width = raster.size
    waiting, complete = deque(windows(raster)), 0
    shown = reachable(posed, raster.camera, papr.config.cutoff)
    for wanted in torch.arange(height * width).split(chunk):
        rays, sent = _rays_of(raster, wanted), wanted
        if shown is not None:
            met = shown.view(-1)[wanted]
            _leave_out(canvas, wanted[~met])
            rays, sent = rays[met], wanted[met]
        if len(sent):
            trace_pixels(canvas, papr, posed, rays, sent, threshold)
        yield complete
        while waiting and waiting[0][0][0].stop * width <= wanted[-1] + 1:
            window = waiting.popleft()
            colour_tile(canvas, papr, window, raster.step)
            rows, columns = window[2]
            complete = rows.stop if columns.stop == width else complete
            yield complete


def _leave_out(canvas: Canvas, pixels: Tensor) -> None:
    """Fill pixels (M,), given by their numbers, with what rays have that hit nothing."""
    flat = pixels.to(canvas.alpha.device)
    rows, width, channels = canvas.features.shape
    canvas.features.view(-1, channels)[flat % (rows * width)] = 0.0
    canvas.alpha.view(-1)[flat] = 0.0
    canvas.surface.view(-1, 3)[flat] = math.nan


def _rays_of(raster: Raster, wanted: Tensor) -> RayBundle:
    """Rays (M, S) of M consecutive pixels, given by their numbers."""
    camera = raster.camera
    first, last = int(wanted[0]) // camera.width, int(wanted[-1]) // camera.width
    rows = camera.rays(top=first, height=last + 1 - first, places=raster.places).by_pixel()
    start = int(wanted[0]) - first * camera.width
    return rows[start : start + len(wanted)]


def trace_pixels(
    canvas: Canvas,
    papr: Papr,
    posed: PosedCloud,
    rays: RayBundle,
    pixel_of_row: Tensor,
    threshold: float,
) -> None:
    """Fill M pixels, given by their numbers, with what their rays hit, (M, S) of them."""
    sent, flat = rays.each(lambda one: one.to(canvas.alpha)), pixel_of_row.to(canvas.alpha.device)
    hits = trace(papr, posed, sent, threshold=threshold)
    surface, gains = surface_of(posed, sent.flat(), hits, papr.config.cutoff)
    features, alpha, gain = pixel_means(hits, gains, rays.shape[-1])
    rows, width, channels = canvas.features.shape
    canvas.features.view(-1, channels)[flat % (rows * width)] = features
    canvas.alpha.view(-1)[flat] = alpha
    if gain is not None:
        canvas.gain.view(-1)[flat] = gain
    places = surface.reshape(*rays.shape, 3)
    canvas.surface.view(-1, 3)[flat] = middle_surface(places, sent.origins)


def pixel_means(
    hits: Hits, gains: Tensor | None, samples: int
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Average R = P * S rays over P pixels, whose S rays follow one another.

    Args:
        hits: of the rays.
        gains: (R,) factor on the brightness of what they hit; None leaves it as it is.
        samples: S.

    Returns:
        Features (P, C), opacity (P,), and gains (P,) where there are any: rays count by their
        opacity, so that those that hit nothing do not darken an edge.
    """

    def mean(values: Tensor) -> Tensor:
        return values.unflatten(0, (-1, samples)).mean(dim=1)

    opacity = 1 - hits.background
    alpha = mean(opacity)
    gain = None if gains is None else mean(opacity * gains) / alpha.clamp_min(_LEAST_OPACITY)
    return mean(hits.features), alpha, gain


def colour(
    papr: Papr,
    features: Tensor,
    alpha: Tensor,
    background: Tensor | None = None,
    gain: Tensor | None = None,
) -> Tensor:
    """Colours (..., H, W, 3) of feature maps over a background.

    Args:
        papr: the networks.
        features: (..., H, W, C).
        alpha: (..., H, W) opacity.
        background: (3,) colour; None takes the configured one.
        gain: (..., H, W) factor on the object's brightness; None leaves it as it is.
    """
    colours: Tensor = papr(features)
    if background is None:
        background = constant(papr.config.background, colours)
    if gain is not None:
        colours = colours * gain.unsqueeze(-1)
    opacity = alpha.unsqueeze(-1)
    return colours * opacity + background * (1 - opacity)


def colour_tile(canvas: Canvas, papr: Papr, window: Window, step: int) -> None:
    """Fill the colours of a tile whose surroundings are traced.

    Args:
        canvas: with features, opacity and gain of all that the tile sees.
        papr: the networks.
        window: the tile.
        step: pixels between those that the UNet sees beside each other (`Raster`).
    """
    canvas.rgb[window[2]] = constant(papr.config.background, canvas.rgb)
    part = shown_part(canvas.alpha, window, step)
    if part is None:
        return
    inside, trimmed, kept = part
    seen, columns = inside
    rows = torch.arange(seen.start, seen.stop, device=canvas.alpha.device) % len(canvas.features)
    features = canvas.features[:, columns].index_select(0, rows)
    # Copies: what autograd keeps must not change when the canvas fills up.
    alpha, gain = canvas.alpha[inside].clone(), canvas.gain[inside].clone()
    if step == 1:
        colours = colour(papr, features, alpha, gain=gain)
    else:
        colours = _laced(papr, features, alpha, gain, step)
    canvas.rgb[kept] = colours[trimmed]


def _laced(papr: Papr, features: Tensor, alpha: Tensor, gain: Tensor, step: int) -> Tensor:
    """Colours (H, W, 3) of lattices of every so-manieth pixel, one by one.

    The UNet knows zeros beyond the rim of a picture, one pixel of the photos wide. Of a lattice
    they would be a frame of many pixels, so the rim is repeated beyond itself first.
    """
    rim = ALIGNMENT * step
    rows, columns = (
        torch.arange(-rim, n + rim, device=alpha.device).clamp(0, n - 1) for n in alpha.shape
    )
    features, alpha, gain = (
        plane.index_select(1, columns).index_select(0, rows) for plane in (features, alpha, gain)
    )
    # A pixel of the photos is as wide as a step: so is the mean of what the UNet sees.
    features = mean_around(features, step)
    colours = alpha.new_empty(*alpha.shape, 3)
    for row, column in product(range(step), repeat=2):
        lattice = (slice(row, None, step), slice(column, None, step))
        colours[lattice] = colour(papr, features[lattice], alpha[lattice], gain=gain[lattice])
    return colours[rim:-rim, rim:-rim]


def pooled(image: Image, pool: int, camera: Camera) -> Image:
    """Average squares of pixels; the surface is that of the pixel of the middle distance.

    Args:
        image: `pool` times as large as that of the camera.
        pool: side of the squares.
        camera: of the result.
    """
    if pool == 1:
        return image

    def squares(values: Tensor) -> Tensor:
        blocks = values.unflatten(1, (-1, pool)).unflatten(0, (-1, pool))
        return blocks.transpose(1, 2).flatten(2, 3)

    surface = squares(image.surface).flatten(0, 1)
    origins = camera.center.to(surface).expand_as(surface)
    middle = middle_surface(surface, origins).unflatten(0, (camera.height, camera.width))
    return Image(
        rgb=squares(image.rgb).mean(dim=2),
        alpha=squares(image.alpha).mean(dim=2),
        depth=camera.depth(middle),
        surface=middle,
    )


def mean_around(features: Tensor, width: int) -> Tensor:
    """Means (H, W, C) over squares of so many pixels around every pixel, zeros beyond the rim.

    Where the number is even the outermost pixels of a square count half.
    """
    weights = [1.0 / width] * (2 * (width // 2) + 1)
    if width % 2 == 0:
        weights[0] = weights[-1] = 0.5 / width
    return _summed(_summed(features, weights, 0), weights, 1)


def _summed(values: Tensor, weights: list[float], axis: int) -> Tensor:
    """Weighted sum (H, W, C) of shifted copies along an axis.

    A convolution, of each channel by itself, takes thirty times as long.
    """
    reach, size = len(weights) // 2, values.shape[axis]
    total = weights[reach] * values
    for away in range(-min(reach, size - 1), min(reach, size - 1) + 1):
        if away:  # Beyond the rim is nothing to be added.
            there = values.narrow(axis, max(0, away), size - abs(away))
            here = total.narrow(axis, max(0, -away), size - abs(away))
            here.add_(there, alpha=weights[reach + away])
    return total

"""Pictures for a viewer that does not wait: coarse ones first, then the exact one from above.

Coarse pictures attend to every 8th and then every 4th ray of a row and column, a ray once for all
of them. The exact picture is made of the chunks of `render`, so that it is the same bit for bit:
matrix products round otherwise when rays come in other company. The rays of the coarse pictures,
a sixteenth of all, are computed a second time for that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.model.unet import ALIGNMENT
from pcore.render.image import Image
from pcore.render.picture import TILE, asks_gradient, check_cancel, check_request
from pcore.render.raster import Raster, raster_of
from pcore.render.tiles import (
    Canvas,
    colour_tile,
    paint,
    pooled,
    trace_pixels,
)
from pcore.render.windows import rows_in_use, windows

STRIDES = (8, 4)
"""Pixels between the rays of the coarse pictures."""


def render_progressively(
    papr: Papr,
    posed: PosedCloud,
    camera: Camera,
    *,
    strides: Sequence[int] = STRIDES,
    max_rays: int | None = None,
    tile: int = TILE,
    threshold: float = 0.0,
    samples: int | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Iterator[Image]:
    """Yield ever better pictures of the camera's size; the last one is what `render` returns.

    The first ones repeat the pixels of small pictures. Then the exact picture fills up from above,
    a row of tiles at a time. Every picture is a copy that stays as it is. Closing the generator
    ends the work, too.

    Args:
        papr: the networks, on any device.
        posed: the points.
        camera: at least 4 x 4 pixels.
        strides: pixels between the rays of the coarse pictures, each a multiple of the next;
            those whose picture would have less than 4 pixels a side are left out.
        max_rays: as for `render`.
        tile: as for `render`.
        threshold: as for `render`.
        samples: as for `render`; the coarse pictures have one ray per pixel.
        cancel: asked between chunks; True ends the work.

    Raises:
        InputError: as `render`, and for strides that are no multiples of the next, a batch of
            cameras, or where autograd follows anything: these pictures have no gradient.
        RenderCancelledError: `cancel` said so.
    """
    rays = check_request(papr, posed, camera, max_rays, tile)
    if camera.count is not None or asks_gradient(papr, posed, camera):
        raise InputError(
            "render_progressively: expected one camera and nothing that asks for a gradient; call "
            "`render`, or use torch.no_grad()"
        )
    _check_strides(strides)
    raster = raster_of(papr.config, posed, camera, samples, tile)
    posed = posed.to(next(papr.parameters()).device)
    yield from _stages(papr, posed, camera, raster, strides, rays, tile, threshold, cancel)


@torch.no_grad()
def _stages(
    papr: Papr,
    posed: PosedCloud,
    camera: Camera,
    raster: Raster,
    strides: Sequence[int],
    rays: int,
    tile: int,
    threshold: float,
    cancel: Callable[[], bool] | None,
) -> Iterator[Image]:
    """Coarse pictures, then the exact one from above."""
    shown: Image | None = None
    for small, stride in _coarse(papr, posed, camera, strides, rays, tile, threshold, cancel):
        shown = _enlarged(small.image(camera), stride, camera)
        yield shown
    chunk, finished = max(1, rays // len(raster.places)), 0
    canvas = Canvas.blank(papr, raster.size, rows_in_use(raster, chunk))
    check_cancel(cancel)
    for rows in paint(canvas, papr, posed, raster, chunk, threshold):
        complete = rows // raster.pool
        if shown is not None and finished < rows and complete < camera.height:
            so_far = pooled(canvas.image(raster.camera), raster.pool, camera)
            shown = _with_rows(shown, so_far, complete)
            yield shown
        finished = rows
        check_cancel(cancel)
    yield pooled(canvas.image(raster.camera), raster.pool, camera)


def _check_strides(strides: Sequence[int]) -> None:
    multiples = all(one % other == 0 for one, other in pairwise(strides))
    if not multiples or any(one < 2 for one in strides):
        raise InputError(
            "render_progressively: expected strides of at least 2, each a multiple of the next, "
            f"got {tuple(strides)}"
        )


def _coarse(
    papr: Papr,
    posed: PosedCloud,
    camera: Camera,
    strides: Sequence[int],
    chunk: int,
    tile: int,
    threshold: float,
    cancel: Callable[[], bool] | None,
) -> Iterator[tuple[Canvas, int]]:
    """Small pictures and the distance between their rays."""
    rays, before = camera.rays(), None
    for stride in strides:
        # All grids share their first ray, half of the least stride from the corner.
        part = slice(strides[-1] // 2, None, stride)
        grid = rays[part, part]
        height, width = grid.pixels
        if min(height, width) < ALIGNMENT:
            continue
        canvas = Canvas.blank(papr, (height, width))
        pixels = grid.by_pixel()
        for wanted in _take_over(canvas, before, stride).split(chunk):
            check_cancel(cancel)
            trace_pixels(canvas, papr, posed, pixels[wanted], wanted, threshold)
        small = camera.resized(width, height)
        for window in windows(raster_of(papr.config, posed, small, 1, tile, detail=1.0)):
            check_cancel(cancel)
            colour_tile(canvas, papr, window, 1)
        before = canvas, stride
        yield before


def _take_over(canvas: Canvas, before: tuple[Canvas, int] | None, stride: int) -> Tensor:
    """Copy what the picture before knows; return the numbers of the pixels that it does not."""
    missing = torch.ones(canvas.alpha.shape, dtype=torch.bool)
    if before is not None:
        every = slice(None, None, before[1] // stride)
        for name in ("features", "alpha", "gain", "surface"):
            getattr(canvas, name)[every, every] = getattr(before[0], name)
        missing[every, every] = False
    return missing.flatten().nonzero().squeeze(-1)


def _enlarged(image: Image, stride: int, camera: Camera) -> Image:
    """Repeat the pixels of a small picture until it has the camera's size."""
    height, width = image.alpha.shape
    rows = (torch.arange(camera.height) // stride).clamp_max(height - 1).unsqueeze(1)
    columns = (torch.arange(camera.width) // stride).clamp_max(width - 1)
    return image.each(lambda plane: plane[rows, columns])


def _with_rows(old: Image, new: Image, rows: int) -> Image:
    """Return the old picture with the first rows of the new one."""
    return Image(
        rgb=torch.cat([new.rgb[:rows], old.rgb[rows:]]),
        alpha=torch.cat([new.alpha[:rows], old.alpha[rows:]]),
        depth=torch.cat([new.depth[:rows], old.depth[rows:]]),
        surface=torch.cat([new.surface[:rows], old.surface[rows:]]),
    )

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
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.model.passes import (
    Canvas,
    Picture,
    Steps,
    attend,
    pooled,
    rows_in_use,
    shade,
    windows,
)
from pcore.model.raster import raster_of
from pcore.model.render import TILE, check_request, paint
from pcore.model.unet import ALIGNMENT

STRIDES = (8, 4)
"""Pixels between the rays of the coarse pictures."""


@torch.no_grad()
def render_progressively(
    papr: Papr,
    cloud: PointCloud,
    camera: Camera,
    *,
    strides: Sequence[int] = STRIDES,
    max_rays: int | None = None,
    tile: int = TILE,
    threshold: float = 0.0,
    samples: int | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Iterator[Picture]:
    """Yield ever better pictures of the camera's size; the last one is what `render` returns.

    The first ones repeat the pixels of small pictures. Then the exact picture fills up from above,
    a row of tiles at a time. Every picture is a copy that stays as it is. Closing the generator
    ends the work, too.

    Args:
        papr: the networks, on any device.
        cloud: the points.
        camera: at least 4 x 4 pixels.
        strides: pixels between the rays of the coarse pictures, each a multiple of the next;
            those whose picture would have less than 4 pixels a side are left out.
        max_rays: as for `render`.
        tile: as for `render`.
        threshold: as for `render`.
        samples: as for `render`; the coarse pictures have one ray per pixel.
        cancel: asked between chunks; True ends the work.

    Raises:
        InputError: as `render`, and for strides that are no multiples of the next.
        RenderCancelledError: `cancel` said so.
    """
    rays = check_request(papr, cloud, camera, max_rays, tile)
    raster = raster_of(papr.config, cloud, camera, samples, tile)
    chunk = max(1, rays // len(raster.places))
    _check_strides(strides)
    steps, cloud = Steps(1, cancel, None), cloud.to(next(papr.parameters()).device)
    shown: Picture | None = None
    for small, stride in _coarse(papr, cloud, camera, strides, rays, tile, threshold, steps):
        shown = _enlarged(small.picture(camera), stride, camera)
        yield shown
    canvas = Canvas.blank(papr, raster.size, rows_in_use(raster, chunk))
    for rows in paint(canvas, papr, cloud, raster, chunk, threshold, steps):
        complete = rows // raster.pool
        if shown is not None and complete < camera.height:
            so_far = pooled(canvas.picture(raster.camera), raster.pool, camera)
            shown = _with_rows(shown, so_far, complete)
            yield shown
    yield pooled(canvas.picture(raster.camera), raster.pool, camera)


def _check_strides(strides: Sequence[int]) -> None:
    multiples = all(one % other == 0 for one, other in pairwise(strides))
    if not multiples or any(one < 2 for one in strides):
        raise InputError(
            "render_progressively: expected strides of at least 2, each a multiple of the next, "
            f"got {tuple(strides)}"
        )


def _coarse(
    papr: Papr,
    cloud: PointCloud,
    camera: Camera,
    strides: Sequence[int],
    chunk: int,
    tile: int,
    threshold: float,
    steps: Steps,
) -> Iterator[tuple[Canvas, int]]:
    """Small pictures and the distance between their rays."""
    rays, before = camera.rays(), None
    for stride in strides:
        # All grids share their first ray, half of the least stride from the corner.
        part = slice(strides[-1] // 2, None, stride)
        grid = RayBundle(origins=rays.origins[part, part], directions=rays.directions[part, part])
        height, width = grid.shape
        if min(height, width) < ALIGNMENT:
            continue
        canvas = Canvas.blank(papr, (height, width))
        flat = grid.flat()
        for wanted in _take_over(canvas, before, stride).split(chunk):
            steps.check()
            attend(canvas, papr, cloud, flat[wanted.unsqueeze(-1)], wanted, threshold)
        small = camera.resized(width, height)
        for window in windows(raster_of(papr.config, cloud, small, 1, tile, detail=1.0)):
            steps.check()
            shade(canvas, papr, window, 1)
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


def _enlarged(picture: Picture, stride: int, camera: Camera) -> Picture:
    """Repeat the pixels of a small picture until it has the camera's size."""
    height, width = picture.alpha.shape
    rows = (torch.arange(camera.height) // stride).clamp_max(height - 1).unsqueeze(1)
    columns = (torch.arange(camera.width) // stride).clamp_max(width - 1)
    return Picture(**{name: one[rows, columns] for name, one in vars(picture).items()})


def _with_rows(old: Picture, new: Picture, rows: int) -> Picture:
    """Return the old picture with the first rows of the new one."""
    return Picture(
        **{
            name: torch.cat([one[:rows], getattr(old, name)[rows:]])
            for name, one in vars(new).items()
        }
    )

"""How a picture is sampled so that the renderer network sees pixels of the size it was trained on.

The UNet has learned what neighbouring pixels have in common at one distance between them. A picture
that is finer than the photos is coloured in interleaved lattices of that distance, one that is
coarser as a larger picture whose pixels are then averaged.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.pixel_samples import check_samples, grid_places
from pcore.geometry.posed import PosedCloud
from pcore.model.papr_config import PaprConfig
from pcore.model.unet import ALIGNMENT, RECEPTIVE_MARGIN

_FINEST, _COARSEST = 16, 4
_COARSE = 0.8
"""Photos' pixels per pixel of a picture. Below this a larger picture is averaged: on held-out views
that loses up to 1.4 dB at 1 and wins 3 at 0.7 (ADR 13)."""
_LATTICE_TILES = 4
"""A tile of lattices is up to so many times as large, so that their margins cost little."""
_CLOSEST = 0.5
"""In radii of the cloud: a camera nearer than that to the middle point counts as that far."""


@dataclass(frozen=True, kw_only=True)
class Raster:
    """What is attended to and coloured for the picture of a camera.

    Attributes:
        camera: takes the picture that is drawn, `pool` times the size of the one asked for.
        places: (S, 2) where in its pixels rays go.
        step: pixels between those that the UNet sees beside each other.
        pool: side of the squares of pixels that are averaged in the end.
        tile: side of the UNet's tiles in pixels.
    """

    camera: Camera
    places: Tensor
    step: int
    pool: int
    tile: int

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.camera.height, self.camera.width

    @property
    def margin(self) -> int:
        """Pixels around a tile that its colours depend on, a multiple of the UNet's grid."""
        return self.step * RECEPTIVE_MARGIN


def raster_of(
    config: PaprConfig,
    posed: PosedCloud,
    camera: Camera,
    samples: int | None,
    tile: int,
    detail: float | None = None,
) -> Raster:
    """Choose how a picture is sampled.

    Args:
        config: of the model; without its `pixel` every picture is drawn as it comes.
        posed: the points.
        camera: of the picture that is asked for.
        samples: its rays per pixel, a square number; None asks the model, and takes more where a
            larger picture needs them.
        tile: side of the UNet's tiles in pixels, a multiple of 4.
        detail: as `photo_pixels` finds it; None asks that. A film has one for all its frames.

    Raises:
        InputError: rays per pixel that make no square.
    """
    side = math.isqrt(check_samples("pixel", config.samples if samples is None else samples))
    detail = photo_pixels(config, posed, camera) if detail is None else detail
    pool, step = 1, 1
    if detail < _COARSE:
        pool = min(max(2, round(1 / detail)), _COARSEST if samples is None else side)
        camera = camera.resized(pool * camera.width, pool * camera.height)
        side = math.ceil(side / pool)
    else:
        most = min(camera.height, camera.width) // ALIGNMENT
        step = max(1, min(round(detail), most))
    grid = ALIGNMENT * step
    return Raster(
        camera=camera,
        places=grid_places(side * side),
        step=step,
        pool=pool,
        tile=max(grid, min(step, _LATTICE_TILES) * tile // grid * grid),
    )


def photo_pixels(config: PaprConfig, posed: PosedCloud, camera: Camera) -> float:
    """How many pixels of a camera are as wide as one of the photos, at the object; 1/16 to 16.

    An edit that enlarges the object spreads what was one pixel over more of them. 1 where the
    model does not know its photos.
    """
    if config.pixel is None:
        return 1.0
    depth = float(camera.depth(posed.positions.detach().cpu()).detach().median())
    depth = max(depth, _CLOSEST * posed.sphere[1])
    focal = 0.5 * sum(camera.focal)
    detail = config.pixel * posed.growth * focal / depth
    return min(max(detail, 1 / _FINEST), _FINEST)


def film_detail(
    config: PaprConfig, poses: Sequence[PosedCloud], cameras: Sequence[Camera]
) -> float:
    """One `photo_pixels` for all frames of a film, the median, so that its look does not jump.

    Args:
        config: of the model.
        poses: the points of every frame.
        cameras: of every frame.
    """
    pairs = zip(poses, cameras, strict=True)
    return statistics.median(photo_pixels(config, posed, camera) for posed, camera in pairs)

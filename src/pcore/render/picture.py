"""Whole pictures with bounded memory, of cameras or of rays.

The result is that of one pass over the whole image; see `tiles`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from pcore.errors import InputError, PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import determinants
from pcore.model.encoding import encoded_size
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig
from pcore.model.unet import ALIGNMENT
from pcore.render.image import Image
from pcore.render.raster import Raster, raster_of
from pcore.render.surface import middle_surface, surface_of
from pcore.render.tiles import Canvas, colour, paint, pixel_means, pooled
from pcore.render.trace import trace
from pcore.render.windows import rows_in_use, windows
from pcore.validation import check_count

FAST_THRESHOLD = 0.03
"""Of `pcore render --fast`. Measured on 12 test views of four trained `tiny` models: PSNR against
the exact picture 60.4 dB or more, no colour off by more than 0.021 (0.01: 68.6 dB; 0.1: 50.4)."""
_ATTENTION_BYTES = {"cuda": 2 * 2**30}
_LEAST_ATTENTION_BYTES = 512 * 2**20
"""What a chunk of rays may take. A GPU needs more of them at once to be busy: a picture of
800 x 800 pixels at the sizes of `paper` is 31 chunks there, and would be 123. The kernels of the
CPU need about a third of this. Every chunk costs some milliseconds whatever its size, of an edit
several times as many."""
TILE = 256

Progress = Callable[[float], None]


class RenderCancelledError(PcoreError):
    """The caller asked a running `render` to stop; there is no picture."""


def render(
    papr: Papr,
    posed: PosedCloud,
    camera: Camera | Sequence[Camera],
    *,
    max_rays: int | None = None,
    tile: int = TILE,
    threshold: float = 0.0,
    samples: int | None = None,
    detail: float | None = None,
    cancel: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Image:
    """Render what cameras see; colours are those of one pass, for any chunk and tile.

    A picture whose pixels are another size than the photos' is sampled so that the renderer network
    sees the size it knows (`pcore.render.raster`).

    The surface point of a ray is where it meets the surfels of the pose, or, where there are none,
    the mean over one layer of points (`pcore.render.surface`); with several rays per pixel it is
    that of the ray whose distance is the middle one (the nearer of two).

    Autograd follows the networks, all tensors of the pose, and the cameras, where any of them asks
    for a gradient (the whole picture is then held in memory); which points a ray meets is fixed.

    Args:
        papr: the networks, on any device; the work is done there.
        posed: the points, world units.
        camera: at least 4 x 4 pixels (the UNet halves the picture twice); a batch, or several of
            one size, make a batch of pictures, one after another.
        max_rays: rays attended to at once; None takes as many as fit about 512 MB, or
            2 GB of a GPU.
        tile: side of the UNet's tiles in pixels, a multiple of 4.
        threshold: points with less than this weight on a ray add nothing to its colour; 0 is
            exact, `FAST_THRESHOLD` is what `pcore render --fast` takes.
        samples: rays per pixel, a square number; None takes the model's (`PaprConfig.samples`).
        detail: pixels of this picture per pixel of the photos; None measures it. The frames of a
            film should share one (`pcore.render.raster.photo_pixels`), or its look may jump.
        cancel: asked between chunks; True ends the work.
        progress: told between chunks which share of the work is done, in (0, 1].

    Raises:
        InputError: an image, tile or chunk that is too small, rays per pixel that make no square,
            cameras of different sizes, no points, NaN or infinity in them or in their local maps
            or surfels, or local maps that fold space.
        RenderCancelledError: `cancel` said so.
    """
    camera = camera if isinstance(camera, Camera) else Camera.stack(camera)
    images, total = list[Image](), camera.count or 1

    def tell(share: float) -> None:
        if progress is not None:
            progress((len(images) + share) / total)

    for one in camera:
        chunk = check_request(papr, posed, one, max_rays, tile)
        raster = raster_of(papr.config, posed, one, samples, tile, detail)
        with torch.set_grad_enabled(asks_gradient(papr, posed, one)):
            images.append(_picture(papr, posed, one, raster, chunk, threshold, cancel, tell))
    return images[0] if camera.count is None else Image.stack(images)


def _picture(
    papr: Papr,
    posed: PosedCloud,
    camera: Camera,
    raster: Raster,
    rays: int,
    threshold: float,
    cancel: Callable[[], bool] | None,
    progress: Progress,
) -> Image:
    """One picture of a camera, so many rays at once."""
    chunk = max(1, rays // len(raster.places))
    total = math.ceil(math.prod(raster.size) / chunk) + len(list(windows(raster)))
    # Autograd wants all rows of features, not room for some.
    rows = None if torch.is_grad_enabled() else rows_in_use(raster, chunk)
    canvas = Canvas.blank(papr, raster.size, rows)
    check_cancel(cancel)
    steps = paint(canvas, papr, posed.to(canvas.alpha.device), raster, chunk, threshold)
    for count, _ in enumerate(steps, start=1):
        progress(count / total)
        if count < total:
            check_cancel(cancel)
    return pooled(canvas.image(raster.camera), raster.pool, camera)


def render_rays(
    papr: Papr,
    posed: PosedCloud,
    rays: RayBundle,
    background: Tensor | None = None,
    *,
    threshold: float = 0.0,
    stop_encoding: bool = False,
    geometry: bool = True,
) -> Image:
    """Render rays in one piece, as training does: one ray or several per pixel, any cameras.

    Args:
        papr: the networks.
        posed: the points, world units, on the device of the networks.
        rays: pixels (..., H, W), with `rays.samples` rays each.
        background: (3,) colour behind the object; None takes the configured one.
        threshold: as for `render`.
        stop_encoding: as `ProximityAttention.forward` has it; training sets it.
        geometry: find depth and surface; otherwise both are NaN.

    Returns:
        Pictures (..., H, W) with `hits`, differentiable in the networks, the pose and the rays.

    Raises:
        InputError: rays that are no picture.
    """
    shape, samples = rays.pixels, rays.samples or 1
    if len(shape) < 2 or min(shape[-2:]) < ALIGNMENT:
        raise InputError(
            f"render_rays: expected rays of pixels (..., H, W), at least {ALIGNMENT} x "
            f"{ALIGNMENT} of them, got {shape}"
        )
    hits = trace(papr, posed, rays, threshold=threshold, stop_encoding=stop_encoding)
    pixels = rays.by_pixel()
    surface = pixels.origins.new_full((), math.nan).expand(len(pixels.origins), 3)
    gains = None
    if geometry or posed.gains is not None:
        places, gains = surface_of(posed, rays.flat(), hits, papr.config.cutoff)
        surface = middle_surface(places.reshape(*pixels.shape, 3), pixels.origins)
    offset = surface - pixels.origins.mean(dim=1)
    # What hits nothing has no gradient, rather than one that is NaN.
    unknown = offset.isnan().any(dim=-1)
    distance = offset.masked_fill(unknown.unsqueeze(-1), 0.0).norm(dim=-1)
    distance = distance.masked_fill(unknown, math.nan)
    features, alpha, gain = pixel_means(hits, gains, samples)
    alpha = alpha.reshape(shape)
    gain = None if gain is None else gain.reshape(shape)
    return Image(
        rgb=colour(papr, features.reshape(*shape, -1), alpha, background, gain),
        alpha=alpha,
        depth=distance.reshape(shape),
        surface=surface.reshape(*shape, 3),
        hits=hits,
    )


def asks_gradient(papr: Papr, posed: PosedCloud, camera: Camera) -> bool:
    """Whether autograd follows anything that a picture is made of."""
    networks = torch.is_grad_enabled() and any(one.requires_grad for one in papr.parameters())
    return networks or posed.asks_gradient or camera.asks_gradient


def check_cancel(cancel: Callable[[], bool] | None) -> None:
    """Raise RenderCancelledError when the caller says so."""
    if cancel is not None and cancel():
        raise RenderCancelledError("the rendering was cancelled before it was complete")


def check_request(
    papr: Papr, posed: PosedCloud, camera: Camera, max_rays: int | None, tile: int
) -> int:
    """Raise InputError where `render` would; return the number of rays of a chunk."""
    if camera.height < ALIGNMENT or camera.width < ALIGNMENT:
        raise InputError(
            f"render: expected an image of at least {ALIGNMENT} x {ALIGNMENT} pixels, "
            f"got {camera.width} x {camera.height}; ask for a larger one"
        )
    check_count("render: tile", tile, minimum=ALIGNMENT)
    if tile % ALIGNMENT:
        raise InputError(f"render: expected a tile that is a multiple of {ALIGNMENT}, got {tile}")
    _check_pose(posed)
    return check_count("render: max_rays", max_rays or _rays_at_once(papr))


def _check_pose(posed: PosedCloud) -> None:
    """Raise rather than draw a black picture of points that a deformation has torn to NaN."""
    parts = {"position": posed.positions}
    if posed.local_maps is not None:
        parts |= {"rest position": posed.cloud.positions, "local map": posed.local_maps.to_rest}
    if posed.surfels is not None:
        parts["surfel"] = torch.cat([posed.surfels.places, posed.surfels.normals], dim=1)
    if posed.gains is not None:
        parts["gain"] = posed.gains
    for name, part in parts.items():
        bad = int((~torch.isfinite(part).reshape(len(posed), -1).all(dim=1)).sum())
        if bad:
            raise InputError(
                f"render: expected finite points, got NaN or infinity in the {name} of {bad} of "
                f"{len(posed)}; lower the amount of the deformation, or check its file"
            )
    if posed.local_maps is None:
        return
    folded = int((~(determinants(posed.local_maps.to_rest.detach()) > 0)).sum())
    if folded:
        raise InputError(
            f"render: expected local maps that keep space right side out (det > 0), got {folded} "
            f"of {len(posed)} that do not; estimate maps from the points, or use plain rays"
        )


def _rays_at_once(papr: Papr) -> int:
    kind = next(papr.parameters()).device.type
    return rays_within(papr.config, _ATTENTION_BYTES.get(kind, _LEAST_ATTENTION_BYTES))


def rays_within(config: PaprConfig, memory: int) -> int:
    """Rays whose attention fits `memory` bytes (an estimate on the safe side); at least 256."""
    octaves = config.octaves
    point, offset = octaves.point, (octaves.along, octaves.across)
    encoded = encoded_size(3, point) + 2 * sum(encoded_size(3, number) for number in offset)
    widest = max(config.key.width, config.value.width, config.key.size)
    per_pair = encoded + config.feature_size + 4 * widest
    return max(256, memory // (4 * config.neighbours * per_pair))

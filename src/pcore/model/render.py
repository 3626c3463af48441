"""Whole pictures with bounded memory: rays in chunks, the renderer network in tiles.

The result is that of one forward pass over the whole image; see `passes`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.encoding import encoded_size
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig
from pcore.model.passes import (
    Canvas,
    Picture,
    Progress,
    Steps,
    attend,
    pooled,
    rows_in_use,
    shade,
    windows,
)
from pcore.model.raster import Raster, raster_of
from pcore.model.unet import ALIGNMENT
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
_SOLID = 0.5
_STEEPEST = math.tan(math.radians(80))


@torch.no_grad()
def render(
    papr: Papr,
    cloud: PointCloud,
    camera: Camera,
    *,
    max_rays: int | None = None,
    tile: int = TILE,
    threshold: float = 0.0,
    samples: int | None = None,
    detail: float | None = None,
    cancel: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Picture:
    """Render what a camera sees; colours are those of one forward pass, for any chunk and tile.

    A picture whose pixels are another size than the photos' is sampled so that the renderer network
    sees the size it knows (`pcore.model.raster`).

    The surface point of a ray is where it meets the skin of the cloud, or, where there is none, the
    mean over one layer of points (`pcore.model.surface`); with
    several rays per pixel it is that of the ray whose distance is the middle one (the nearer of
    two).

    Args:
        papr: the networks, on any device; the work is done there.
        cloud: the points, canonical or deformed, world units.
        camera: at least 4 x 4 pixels (the UNet halves the picture twice).
        max_rays: rays attended to at once; None takes as many as fit about 512 MB, or
            2 GB of a GPU.
        tile: side of the UNet's tiles in pixels, a multiple of 4.
        threshold: points with less than this weight on a ray add nothing to its colour; 0 is
            exact, `FAST_THRESHOLD` is what `pcore render --fast` takes.
        samples: rays per pixel, a square number; None takes the model's (`PaprConfig.samples`).
        detail: pixels of this picture per pixel of the photos; None measures it. The frames of a
            film should share one (`pcore.model.raster.photo_pixels`), or its look may jump.
        cancel: asked between chunks; True ends the work.
        progress: told between chunks which share of the work is done, in (0, 1].

    Raises:
        InputError: an image, tile or chunk that is too small, rays per pixel that make no square,
            an empty cloud, or one with NaN or infinity in its positions or frames, or frames that
            fold space.
        RenderCancelledError: `cancel` said so.
    """
    chunk = check_request(papr, cloud, camera, max_rays, tile)
    raster = raster_of(papr.config, cloud, camera, samples, tile, detail)
    chunk = max(1, chunk // len(raster.places))
    total = math.ceil(math.prod(raster.size) / chunk) + len(list(windows(raster)))
    canvas = Canvas.blank(papr, raster.size, rows_in_use(raster, chunk))
    steps = Steps(total, cancel, progress)
    for _ in paint(canvas, papr, cloud, raster, chunk, threshold, steps):
        pass
    return pooled(canvas.picture(raster.camera), raster.pool, camera)


def check_request(
    papr: Papr, cloud: PointCloud, camera: Camera, max_rays: int | None, tile: int
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
    _check_cloud(cloud)
    return check_count("render: max_rays", max_rays or _rays_at_once(papr))


def paint(
    canvas: Canvas,
    papr: Papr,
    cloud: PointCloud,
    raster: Raster,
    chunk: int,
    threshold: float,
    steps: Steps,
) -> Iterator[int]:
    """Fill a canvas from above; yield the number of its complete rows with every row of tiles."""
    cloud, (height, width) = cloud.to(canvas.alpha.device), raster.size
    waiting = deque(windows(raster))
    for wanted in torch.arange(height * width).split(chunk):
        steps.check()
        rays = _rays_of(raster.camera, wanted, raster.places)
        attend(canvas, papr, cloud, rays, wanted, threshold)
        steps.done()
        while waiting and waiting[0].seen[0].stop * width <= wanted[-1] + 1:
            steps.check()
            window = waiting.popleft()
            shade(canvas, papr, window, raster.step)
            steps.done()
            if window.kept[1].stop == width:
                yield window.kept[0].stop


def _rays_of(camera: Camera, wanted: Tensor, places: Tensor) -> RayBundle:
    """Rays (M, S) of M consecutive pixels, given by their numbers."""
    first, last = int(wanted[0]) // camera.width, int(wanted[-1]) // camera.width
    rows = camera.rays(top=first, height=last + 1 - first, places=places)
    start = int(wanted[0]) - first * camera.width
    part = slice(start, start + len(wanted))
    shape = (-1, len(places), 3)
    return RayBundle(
        origins=rows.origins.reshape(shape)[part], directions=rows.directions.reshape(shape)[part]
    )


def _check_cloud(cloud: PointCloud) -> None:
    """Raise rather than draw a black picture of a cloud that a deformation has torn to NaN."""
    frames = cloud.frames
    parts = {"position": cloud.positions}
    if frames is not None:
        parts |= {"rest position": frames.rest, "local map": frames.to_rest}
    finite = {name: torch.isfinite(one).flatten(1).all(dim=1) for name, one in parts.items()}
    if cloud.skin is not None:
        finite["skin"] = cloud.skin.finite
    for name, whole in finite.items():
        bad = int((~whole).sum())
        if bad:
            raise InputError(
                f"render: expected finite points, got NaN or infinity in the {name} of {bad} of "
                f"{len(cloud)}; lower the amount of the deformation, or check its file"
            )
    if frames is None:
        return
    first, second, third = frames.to_rest.unbind(dim=-2)
    # Closed form: torch.linalg.det factorises matrix by matrix.
    determinant = (first * torch.linalg.cross(second, third)).sum(dim=-1)
    folded = int((~(determinant > 0)).sum())
    if folded:
        raise InputError(
            f"render: expected local maps that keep space right side out (det > 0), got {folded} "
            f"of {len(cloud)} that do not; estimate frames from the points, or use plain rays"
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


def normals(picture: Picture, camera: Camera) -> Tensor:
    """Unit normals (H, W, 3) of the predicted surface, world axes, facing the camera.

    They are the cross product of central differences of the surface points. NaN at the border,
    where the pixel or a neighbour is not solid (alpha below 0.5), and across jumps of depth:
    where the surface would be steeper than 80 degrees to the image plane.
    """
    points, depth = picture.surface, picture.depth
    out = torch.full_like(points, math.nan)
    if min(depth.shape) < 3:
        return out
    right = points[1:-1, 2:] - points[1:-1, :-2]
    down = points[2:, 1:-1] - points[:-2, 1:-1]
    normal = torch.linalg.cross(right, down, dim=-1)
    length = normal.norm(dim=-1, keepdim=True)
    towards = camera.center.to(points) - points[1:-1, 1:-1]
    side = torch.where((normal * towards).sum(dim=-1, keepdim=True) < 0, -1.0, 1.0)
    valid = _smooth(picture, camera) & (length[..., 0] > 0)
    out[1:-1, 1:-1] = torch.where(valid.unsqueeze(-1), side * normal / length, math.nan)
    return out


def _smooth(picture: Picture, camera: Camera) -> Tensor:
    """Where a pixel and its four neighbours are one surface, (H - 2, W - 2)."""
    solid, depth = picture.alpha >= _SOLID, picture.depth
    center = depth[1:-1, 1:-1]
    steepest = _STEEPEST / min(camera.fx, camera.fy)
    valid = solid[1:-1, 1:-1]
    for rows, columns in (
        (slice(1, -1), slice(2, None)),
        (slice(1, -1), slice(None, -2)),
        (slice(2, None), slice(1, -1)),
        (slice(None, -2), slice(1, -1)),
    ):
        beside = depth[rows, columns]
        # A pixel is depth / focal length wide.
        one_surface = (beside - center).abs() <= steepest * torch.maximum(beside, center)
        valid = valid & solid[rows, columns] & one_surface
    return valid

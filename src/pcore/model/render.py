"""Whole pictures with bounded memory: rays in chunks, the renderer network in tiles.

The result is that of one forward pass over the whole image. Attention looks at every ray by
itself; the UNet looks `RECEPTIVE_MARGIN` pixels around, so a tile is computed with that much of
its surroundings, cut where the pooling grid of the whole image lies, and then trimmed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.errors import InputError, PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.model.config import PaprConfig
from pcore.model.encoding import encoded_size
from pcore.model.papr import Papr
from pcore.model.unet import ALIGNMENT, RECEPTIVE_MARGIN
from pcore.validation import check_count

FAST_THRESHOLD = 0.03
"""Of `pcore render --fast`. Measured on 12 test views of four trained `tiny` models: PSNR against
the exact picture 60.4 dB or more, no colour off by more than 0.021 (0.01: 68.6 dB; 0.1: 50.4)."""
_ATTENTION_BYTES = 256 * 2**20
_TILE = 256
_SOLID = 0.5
_STEEPEST = math.tan(math.radians(80))

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


@torch.no_grad()
def render(
    papr: Papr,
    cloud: PointCloud,
    camera: Camera,
    *,
    max_rays: int | None = None,
    tile: int = _TILE,
    threshold: float = 0.0,
    cancel: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Picture:
    """Render what a camera sees; equal to `papr(cloud, camera.rays())` for any chunk and tile.

    Args:
        papr: the networks, on any device; the work is done there.
        cloud: the points, canonical or deformed, world units.
        camera: at least 4 x 4 pixels (the UNet halves the picture twice).
        max_rays: rays attended to at once; None takes as many as fit about 256 MB.
        tile: side of the UNet's tiles in pixels, a multiple of 4.
        threshold: points with less than this weight on a ray add nothing to its colour; 0 is
            exact, `FAST_THRESHOLD` is what `pcore render --fast` takes.
        cancel: asked between chunks; True ends the work.
        progress: told between chunks which share of the work is done, in (0, 1].

    Raises:
        InputError: an image, tile or chunk that is too small, an empty cloud, or one with NaN or
            infinity in its positions or frames, or frames that fold space.
        RenderCancelledError: `cancel` said so.
    """
    if camera.height < ALIGNMENT or camera.width < ALIGNMENT:
        raise InputError(
            f"render: expected an image of at least {ALIGNMENT} x {ALIGNMENT} pixels, "
            f"got {camera.width} x {camera.height}; ask for a larger one"
        )
    check_count("render: tile", tile, minimum=ALIGNMENT)
    if tile % ALIGNMENT:
        raise InputError(f"render: expected a tile that is a multiple of {ALIGNMENT}, got {tile}")
    _check_cloud(cloud)
    chunk = check_count("render: max_rays", max_rays or rays_within(papr.config, _ATTENTION_BYTES))
    device = next(papr.parameters()).device
    rays, size = camera.rays().flat(), (camera.height, camera.width)
    windows = list(_windows(size, tile))
    steps = _Steps(math.ceil(len(rays.origins) / chunk) + len(windows), cancel, progress)

    features, alpha, surface = _attend(papr, cloud.to(device), rays, chunk, threshold, steps)
    features, opacity = features.unflatten(0, size), alpha.unflatten(0, size)
    rgb = torch.empty(*size, 3)
    for window in windows:
        steps.check()
        rgb[window.kept] = papr.shade(features[window.seen], opacity[window.seen])[
            window.trimmed
        ].cpu()
        steps.done()
    surface = surface.unflatten(0, size)
    return Picture(rgb=rgb, alpha=opacity.cpu(), depth=camera.depth(surface), surface=surface)


def _check_cloud(cloud: PointCloud) -> None:
    """Raise rather than draw a black picture of a cloud that a deformation has torn to NaN."""
    frames = cloud.frames
    parts = {"position": cloud.positions}
    if frames is not None:
        parts |= {"rest position": frames.rest, "local map": frames.to_rest}
    for name, values in parts.items():
        bad = int((~torch.isfinite(values).flatten(1).all(dim=1)).sum())
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


def rays_within(config: PaprConfig, memory: int) -> int:
    """Rays whose attention fits `memory` bytes (an estimate on the safe side); at least 256."""
    vector = encoded_size(3, config.frequencies)
    widest = max(config.key.width, config.value.width, config.key.size)
    per_pair = 5 * vector + config.feature_size + 4 * widest
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


Slices = tuple[slice, slice]


@dataclass(frozen=True, kw_only=True)
class _Window:
    """One tile: `seen` with its surroundings, `trimmed` inside of that, `kept` in the image."""

    seen: Slices
    trimmed: Slices
    kept: Slices


def _windows(size: tuple[int, int], tile: int) -> Iterator[_Window]:
    for top in range(0, size[0], tile):
        for left in range(0, size[1], tile):
            spans = [_span(start, tile, end) for start, end in zip((top, left), size, strict=True)]
            seen, trimmed, kept = zip(*spans, strict=True)
            yield _Window(seen=seen, trimmed=trimmed, kept=kept)


def _span(start: int, tile: int, end: int) -> tuple[slice, slice, slice]:
    """Seen, trimmed and kept part along one axis."""
    stop = min(start + tile, end)
    first = max(0, start - RECEPTIVE_MARGIN)
    last = min(end, stop + RECEPTIVE_MARGIN)
    return slice(first, last), slice(start - first, stop - first), slice(start, stop)


class _Steps:
    """Counts chunks of work and talks to the caller between them."""

    def __init__(
        self, total: int, cancel: Callable[[], bool] | None, progress: Progress | None
    ) -> None:
        self._total = total
        self._count = 0
        self._cancel = cancel
        self._progress = progress

    def check(self) -> None:
        if self._cancel is not None and self._cancel():
            raise RenderCancelledError("the rendering was cancelled before it was complete")

    def done(self) -> None:
        self._count += 1
        if self._progress is not None:
            self._progress(self._count / self._total)


def _attend(
    papr: Papr, cloud: PointCloud, rays: RayBundle, chunk: int, threshold: float, steps: _Steps
) -> tuple[Tensor, Tensor, Tensor]:
    """Features (R, C) and opacity (R,) on the model's device, surface (R, 3) on the CPU."""
    device, count = cloud.positions.device, len(rays.origins)
    features = torch.empty(count, papr.config.value.size, device=device)
    alpha = torch.empty(count, device=device)
    surface = torch.empty(count, 3)
    for start in range(0, count, chunk):
        steps.check()
        part = slice(start, start + chunk)
        attended, _ = papr.attend(
            cloud,
            RayBundle(
                origins=rays.origins[part].to(device), directions=rays.directions[part].to(device)
            ),
            threshold,
        )
        features[part] = attended.features
        alpha[part] = 1 - attended.background
        none = attended.weights.sum(dim=-1, keepdim=True) == 0
        surface[part] = attended.surface.masked_fill(none, math.nan).cpu()
        steps.done()
    return features, alpha, surface

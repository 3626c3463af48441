"""Masks of an object in photos that have none: GrabCut within its region, held against one hull.

Every photo is cut by itself (Rother et al. 2004) inside of the outline of what is known to be the
object. Then the masks of all views vote on a hull in space, and every photo is cut again from the
outline of that hull: a view whose cut went wrong is corrected by the others.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pcore.capture.voted_hull import Bits, hull_silhouettes, require_opencv
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region

_LONGEST, _ROUGH = 320, 160
"""Longer side of the pictures whose cuts are masks, pixels: finer ones cost more and find no more;
and of those whose cuts only vote on the hull."""
_VOTERS = 32  # Photos that vote before all are cut: neighbours say the same.
_MARGIN = 0.12
"""Room around an outline in which the cut may still find object, as a share of its size."""
_ROUNDS, _ITERATIONS = 3, 2
_LOOSE, _JUDGED, _SURE = 0.6, 0.75, 0.85
"""Share of the views that see a voxel and must have it in their mask: where the object is looked
for, where masks are judged, and where there is object for certain."""
_FULL, _MOSTLY = 0.97, 0.5
"""Share of a picture that leaves no background, and share of the photos that may lack it."""
_ALONG = 0.3
"""Share of the border of a picture: an object that is photographed ends within, but for a foot."""
_ON_SPHERE = 400
_FEW = 8
"""Fewer points than that have no outline to go by."""
_DOUBTFUL, _BAD = 0.12, 0.6
"""A mask is doubtful whose overlap with the hull is so much less than that of most, or less than
the second in any case."""


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photo to cut.

    Attributes:
        name: of its view.
        camera: pose and lens, for the size that its mask shall have.
        rgb: (H, W, 3) float32 in [0, 1], of that size or smaller (`shrunk`).
    """

    name: str
    camera: Camera
    rgb: Tensor


@dataclass(frozen=True, kw_only=True)
class FoundMasks:
    """Masks of all photos and how well they agree.

    Attributes:
        masks: (H, W) uint8 of every photo, in its size; 255 is object.
        agreement: intersection over union of each with the hull of all.
    """

    masks: tuple[Tensor, ...]
    agreement: tuple[float, ...]

    def doubtful(self) -> tuple[int, ...]:
        """Numbers of the photos whose mask contradicts the others'."""
        return doubtful(self.agreement)


def find_masks(
    photos: Sequence[Photo],
    region: Region,
    *,
    points: Tensor | None = None,
    judged: Sequence[Photo] = (),
    progress: Callable[[int, int], None] | None = None,
) -> FoundMasks:
    """Cut an object out of photos.

    Args:
        photos: at least two, of posed cameras.
        region: where the object is, world units.
        points: (N, 3) points of the object where some are known; their outline is tighter than
            that of the region.
        judged: further photos that get masks and have no vote on the hull, such as test views.
        progress: told (photos cut, cuts in all).

    Returns:
        Masks of `photos`, then of `judged`.

    Raises:
        InputError: no photo shows the region, most show nothing else, no cut leaves anything, or
            what is cut goes on beyond the pictures.
        DependencyError: OpenCV is not installed.
    """
    everyone = [_shrunk(photo, _LONGEST) for photo in (*photos, *judged)]
    voting = [_shrunk(photo, _ROUGH) for photo in _spread(photos)]
    turns = [*[voting] * (_ROUNDS - 1), everyone]
    whole = region.corners if region.box is not None else _sphere(region)
    known = whole if points is None or len(points) < _FEW else points
    seeds = [_outline(photo.camera, known) for photo in voting]
    masks: list[Bits] = []
    cores: list[Bits] | None = None
    total, done = sum(map(len, turns)), 0
    for turn, taken in enumerate(turns):
        # What the points leave out of the object lies in their box.
        rooms = [_outline(photo.camera, whole) for photo in taken]
        nears = [_near(a, b, region) for a, b in zip(seeds, rooms, strict=True)]
        if turn == 0:
            _check_background(seeds, nears)
        inner = [None] * len(taken) if cores is None else cores
        masks = []
        # OpenCV holds no lock while it cuts, and every thread has a generator of its own.
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:
            for mask in pool.map(_cut, [photo.rgb for photo in taken], seeds, nears, inner):
                masks.append(mask)
                done += 1
                if progress is not None:
                    progress(done, total)
        votes = (_JUDGED,) if taken is everyone else (_LOOSE, _SURE)
        voters = [(one.camera, mask) for one, mask in zip(taken, masks, strict=True)]
        following = [one.camera for one in turns[min(turn + 1, _ROUNDS - 1)]]
        seeds, cores = _voted(voters[: len(photos)], region, votes, following)
    _check_filled(masks, "what is cut out")
    _check_ends(masks)
    sized = (
        _resized(mask, one.camera) for mask, one in zip(masks, [*photos, *judged], strict=True)
    )
    return FoundMasks(
        masks=tuple(sized),
        agreement=tuple(overlap(a, b) for a, b in zip(masks, seeds, strict=True)),
    )


def _check_background(seeds: Sequence[Bits], nears: Sequence[Bits]) -> None:
    """Refuse photos of something else, and those that say nothing of the background."""
    if not any(seed.any() for seed in seeds):
        raise InputError(
            "automatic masks: none of the photos shows the object's region; give its --box"
        )
    _check_filled(nears, "the object's region")


def _check_filled(pictures: Sequence[Bits], what: str) -> None:
    """Refuse cuts without background: whole pictures agree with one another and are no masks."""
    filled = sum(float(one.mean()) > _FULL for one in pictures)
    if filled > _MOSTLY * len(pictures):
        raise InputError(
            f"automatic masks: {what} fills {filled} of {len(pictures)} photos, so that nothing "
            "is known to be background; give a tighter --box"
        )


def _check_ends(masks: Sequence[Bits]) -> None:
    """Refuse cuts of what the object stands on: it goes on beyond the pictures, all around."""
    edges = [np.concatenate([one[0], one[-1], one[1:-1, 0], one[1:-1, -1]]) for one in masks]
    along = sum(float(edge.mean()) > _ALONG for edge in edges)
    if along > _MOSTLY * len(masks):
        raise InputError(
            f"automatic masks: what is cut out runs along the border of {along} of {len(masks)} "
            "photos, as a table or floor does; give a tighter --box, or --masks trained"
        )


def _voted(
    voters: Sequence[tuple[Camera, Bits]],
    region: Region,
    votes: Sequence[float],
    into: Sequence[Camera],
) -> tuple[list[Bits], list[Bits] | None]:
    """Silhouettes of the hull that masks vote for: its outline, and its core where that is asked.

    Raises:
        InputError: the masks have nothing in common.
    """
    cameras, masks = [camera for camera, _ in voters], [mask for _, mask in voters]
    seeds, *more = hull_silhouettes(cameras, masks, region, votes=votes, into=into)
    if not any(one.any() for one in seeds):
        raise InputError(
            "automatic masks: the cuts of the photos have no common object inside of the region; "
            "give a tighter --box, --masks trained, or masks of your own (--masks FOLDER)"
        )
    return seeds, more[0] if more else None


def doubtful(agreement: Sequence[float]) -> tuple[int, ...]:
    """Numbers of the masks that contradict the others, by their overlap with the hull of all."""
    limit = max(_BAD, statistics.median(agreement) - _DOUBTFUL)
    return tuple(i for i, share in enumerate(agreement) if share < limit)


def overlap(mask: Bits, other: Bits) -> float:
    """Intersection over union of two masks; 1 where both are empty."""
    union = int((mask | other).sum())
    return 1.0 if union == 0 else int((mask & other).sum()) / union


def shrunk(rgb: Tensor, longest: int = _LONGEST) -> Tensor:
    """A photo (H, W, 3) in the size that is cut, by the mean of areas."""
    height, width = rgb.shape[:2]
    scale = longest / max(width, height)
    if scale >= 1:
        return rgb
    size = max(1, round(scale * width)), max(1, round(scale * height))
    return torch.from_numpy(require_opencv().resize(rgb.numpy(), size, interpolation=3))


def _spread(photos: Sequence[Photo]) -> list[Photo]:
    """At most so many photos as vote, evenly by their order."""
    count = min(_VOTERS, len(photos))
    return [photos[i * len(photos) // count] for i in range(count)]


def _shrunk(photo: Photo, longest: int) -> Photo:
    rgb = shrunk(photo.rgb, longest)
    return replace(photo, camera=photo.camera.resized(rgb.shape[1], rgb.shape[0]), rgb=rgb)


def _outline(camera: Camera, points: Tensor) -> Bits:
    """Convex outline (H, W) 0 or 1 of points in a picture; empty where all are behind it."""
    cv2 = require_opencv()
    column, row, depth = camera.project(points)
    ahead = depth > 0
    picture = np.zeros((camera.height, camera.width), dtype=np.uint8)
    if int(ahead.sum()) < 3:
        return picture
    corners = torch.stack([column, row], dim=-1)[ahead].numpy()
    limit = 8.0 * max(camera.width, camera.height)
    hull = cv2.convexHull(np.clip(corners, -limit, limit).round().astype(np.int32))
    return cv2.fillConvexPoly(picture, hull, 1)


def _sphere(region: Region) -> Tensor:
    """(N, 3) points evenly on the sphere of a region (a Fibonacci lattice)."""
    number = torch.arange(_ON_SPHERE) + 0.5
    z = 1 - 2 * number / _ON_SPHERE
    turn = number * math.pi * (3 - math.sqrt(5))
    around = (1 - z**2).sqrt()
    ball = torch.stack([around * turn.cos(), around * turn.sin(), z], dim=-1)
    return region.center + region.radius * ball


def _reach(seed: Bits) -> int:  # Pixels around an outline that the cut may still take.
    return max(2, round(_MARGIN * math.sqrt(float(seed.sum()))))


def _near(seed: Bits, room: Bits, region: Region) -> Bits:
    """What is not known to be background: a sphere has room in it, a box may be tight."""
    return room if region.box is None else _grown(seed, _reach(seed)) | room


def _cut(rgb: Tensor, seed: Bits, near: Bits, core: Bits | None) -> Bits:
    """GrabCut (H, W) 0 or 1 from an outline, near it; inside of a core is object for certain."""
    cv2 = require_opencv()
    if not seed.any() or near.all():
        return seed  # There is no object, or nothing is known to be background.
    trimap = np.full(seed.shape, cv2.GC_BGD, dtype=np.uint8)
    trimap[near > 0] = cv2.GC_PR_BGD
    trimap[seed > 0] = cv2.GC_PR_FGD
    if core is not None:
        trimap[_shrunken(core, _reach(seed)) > 0] = cv2.GC_FGD
    pixels = (255 * rgb.clamp(0, 1)).round().byte().numpy()
    models = np.zeros((1, 65)), np.zeros((1, 65))
    # OpenCV draws its clusters from a generator of the thread.
    cv2.setRNGSeed(0)
    cv2.grabCut(
        np.ascontiguousarray(pixels), trimap, None, *models, _ITERATIONS, cv2.GC_INIT_WITH_MASK
    )
    found = ((trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)).astype(np.uint8)
    return _largest(cv2.morphologyEx(found, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), seed)


def _largest(mask: Bits, seed: Bits) -> Bits:
    """The parts of a mask that reach into the seed, without specks and with small holes closed."""
    cv2 = require_opencv()
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask
    areas = stats[1:, cv2.CC_STAT_AREA]
    inside = np.bincount(labels[seed > 0], minlength=count)[1:]
    kept = [i + 1 for i in range(count - 1) if areas[i] >= 0.1 * areas.max() and inside[i] > 0]
    whole = np.isin(labels, kept).astype(np.uint8)
    return cv2.morphologyEx(whole, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))


def _grown(mask: Bits, reach: int) -> Bits:
    cv2 = require_opencv()
    return cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2))


def _shrunken(mask: Bits, reach: int) -> Bits:
    cv2 = require_opencv()
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    # What the border of the picture cuts off goes on behind it.
    return cv2.erode(mask, kernel, borderType=cv2.BORDER_REPLICATE)


def _resized(mask: Bits, camera: Camera) -> Tensor:
    """A mask in the size of its photo, with a rim of a pixel's softness."""
    cv2 = require_opencv()
    size = (camera.width, camera.height)
    if mask.shape == (camera.height, camera.width):
        return torch.from_numpy(255 * mask)
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7)
    large = cv2.resize(smooth, size, interpolation=cv2.INTER_CUBIC)
    factor = max(1.0, camera.width / mask.shape[1])
    soft = np.clip((large - 0.5) * factor + 0.5, 0.0, 1.0)
    return torch.from_numpy((255 * soft).round().astype(np.uint8))

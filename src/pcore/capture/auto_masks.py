"""Masks of an object in photos that have none: GrabCut within its region, held against one hull.

Every photo is cut by itself inside of the outline of what is known to be the object. Then the masks
of all views vote on a hull in space, and every photo is cut again from the outline of that hull: a
view whose cut went wrong is corrected by the others. Colours are found once, by the first cuts.
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

from pcore.capture.photo_cut import Colours, cut, near_outline, outline, resized
from pcore.capture.voted_hull import Bits, hull_silhouettes, require_opencv
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region

_LONGEST, _ROUGH = 320, 160
"""Longer side of the pictures whose cuts are masks, pixels: finer ones cost more and find no more;
and of those whose cuts only vote on the hull."""
_VOTERS = 32  # Photos that vote before all are cut: neighbours say the same.
_ROUNDS = 3
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
    seeds = [outline(photo.camera, known) for photo in voting]
    masks: list[Bits] = []
    cores: list[Bits] | None = None
    colours: list[Colours] = []
    total, done = sum(map(len, turns)), 0
    for turn, taken in enumerate(turns):
        # What the points leave out of the object lies in their box.
        rooms = [outline(photo.camera, whole) for photo in taken]
        nears = [near_outline(a, b, region) for a, b in zip(seeds, rooms, strict=True)]
        if turn == 0:
            _check_background(seeds, nears)
        inner = [None] * len(taken) if cores is None else cores
        begin = _beginnings(colours, len(taken), len(photos))
        masks, colours = [], []
        # OpenCV holds no lock while it cuts, and every thread has a generator of its own.
        with ThreadPoolExecutor(torch.get_num_threads()) as pool:
            pictures = [photo.rgb for photo in taken]
            for mask, found in pool.map(cut, pictures, seeds, nears, inner, begin):
                masks.append(mask)
                colours += [] if found is None else [found]
                done += 1
                if progress is not None:
                    progress(done, total)
        votes = (_JUDGED,) if taken is everyone else (_LOOSE, _SURE)
        voters = [(one.camera, mask) for one, mask in zip(taken, masks, strict=True)]
        following = [one.camera for one in turns[min(turn + 1, _ROUNDS - 1)]]
        seeds, cores = _voted(voters[: len(photos)], region, votes, following)
    _check_filled(masks, "what is cut out")
    _check_ends(masks)
    sized = (resized(mask, one.camera) for mask, one in zip(masks, [*photos, *judged], strict=True))
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


def _sphere(region: Region) -> Tensor:
    """(N, 3) points evenly on the sphere of a region (a Fibonacci lattice)."""
    number = torch.arange(_ON_SPHERE) + 0.5
    z = 1 - 2 * number / _ON_SPHERE
    turn = number * math.pi * (3 - math.sqrt(5))
    around = (1 - z**2).sqrt()
    ball = torch.stack([around * turn.cos(), around * turn.sin(), z], dim=-1)
    return region.center + region.radius * ball


def _beginnings(known: Sequence[Colours], count: int, walk: int) -> list[Colours | None]:
    """Colours that each of so many cuts begins with: of the photo beside it on the walk."""
    if not known:
        return [None] * count
    beside = [*range(walk), *(i * walk // max(1, count - walk) for i in range(count - walk))]
    steps = min(walk, count)
    return [known[beside[i] * len(known) // steps] for i in range(count)]

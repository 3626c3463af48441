"""Automatic masks of a whole scene, and the photos that they are cut from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import torch
from torch import Tensor

from pcore.capture.auto_masks import FoundMasks, Photo, find_masks, shrunk
from pcore.capture.photos import natural_key
from pcore.data.scene import Scene, View
from pcore.geometry.object_region import Region

_AT_ONCE = 8
"""Photos that are decoded at a time."""


def scene_masks(
    scene: Scene,
    region: Region,
    *,
    points: Tensor | None = None,
    views: Sequence[View] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[tuple[View, ...], FoundMasks]:
    """Cut the object out of all photos of a scene.

    Training views alone say what the object is; those of other splits get masks from it.

    Args:
        scene: of photos.
        region: where the object is, world units.
        points: (N, 3) sparse points of the object where some are known.
        views: of the scene, those of other splits than training that get masks; default: all.
        progress: told (photos cut, cuts in all).

    Returns:
        Views, those of training first, and their masks.

    Raises:
        InputError: no photo shows the region, or no cut leaves anything.
        DependencyError: OpenCV is not installed.
    """
    train = scene.split("train")
    if views is None:
        views = [view for name in scene.splits for view in scene.split(name)]
    known = {id(view) for view in train}
    others = [view for view in views if id(view) not in known]
    found = find_masks(
        photos_of(train), region, points=points, judged=photos_of(others), progress=progress
    )
    return (*train, *others), found


def photos_of(views: Sequence[View]) -> list[Photo]:
    """Photos of views, on white where they have an alpha channel; small, so that all fit memory."""
    white = torch.ones(3)

    def photo(view: View) -> Photo:
        return Photo(name=view.name, camera=view.camera, rgb=shrunk(view.rgb(white)))

    # Pictures are decoded without a lock; each of them is large until it is shrunk.
    with ThreadPoolExecutor(min(_AT_ONCE, torch.get_num_threads())) as pool:
        return list(pool.map(photo, views))


def ordered_views(scene: Scene) -> tuple[View, ...]:
    """Views of a capture by name; of scenes whose test views are true ones those of `train`.

    Splits of a capture are every eighth photo of one walk around the object.
    """
    return tuple(view for _, view in _ordered(scene))


def ordered_keys(scene: Scene) -> tuple[tuple[str, str], ...]:
    """Split and name of each of `ordered_views`."""
    return tuple((split, view.name) for split, view in _ordered(scene))


def _ordered(scene: Scene) -> list[tuple[str, View]]:
    splits = ["train"] if scene.states or scene.layout == "NeRF-Synthetic" else scene.splits
    pairs = [(split, view) for split in splits for view in scene.split(split)]
    return sorted(pairs, key=lambda pair: natural_key(pair[1].name))

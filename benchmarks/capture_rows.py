"""What is measured of captures, row by row: by the functions that the commands call."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Mapping
from unittest.mock import patch

import numpy as np
import torch
from PIL import Image

import pcore
from benchmarks.capture_exports import mesh, moved
from benchmarks.capture_figures import Figure, Place, command, processor_seconds, scored, trained
from benchmarks.sequential_edits import NAMES, edits_for, rate, sequence
from pcore.capture.photos import pictures_in
from pcore.capture.pose_contradictions import find_contradictions
from pcore.capture.reprojection import reprojection
from pcore.capture.scene_masks import ordered_views
from pcore.data.scene import Scene
from pcore.evaluation.methods import open_subject
from pcore.training.locate import locate

DTU, BEER, FOX = (f"captures/{name}" for name in ("dtu_scan24", "beer", "fox"))
CHAIR, LEGO = "nerf_synthetic/chair", "nerf_synthetic/lego"
_PHOTOS, _SIZE = 20, (360, 640)
"""Of the capture whose poses are found."""


def read(place: Place) -> list[Figure]:
    """Every capture opens without an option; points lie where photos show them; lenses."""
    found: list[Figure] = []
    for folder in (FOX, BEER, DTU, LEGO, CHAIR):
        scene = pcore.load_scene(place.data / folder)
        name, views = scene.name, ordered_views(scene)
        found.append(Figure(what=f"{name}: views", value=len(views), bar=2))
        points = None if scene.sparse is None else reprojection(scene.sparse, views)
        if points is not None:
            what = f"{name}: reprojection of its points, mean, pixels"
            found.append(Figure(what=what, value=points.mean, bar=1, at_most=True))
        off = off_opencv(scene)
        if off is not None:
            what = f"{name}: straightening against OpenCV, largest, pixels"
            found.append(Figure(what=what, value=off, bar=0.02, at_most=True))
    return found


def off_opencv(scene: Scene) -> float | None:
    """How far OpenCV takes pixels from elsewhere, at most; None where no lens is bent."""
    import cv2

    found: list[float] = []
    for view in ordered_views(scene):
        lens, size = view.image.lens, view.image.size
        if lens is None or lens.is_straight:
            continue
        # OpenCV's pixel centres lie at whole numbers.
        matrix = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
        numbers = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
        known = cv2.initUndistortRectifyMap(matrix, numbers, None, matrix, size, cv2.CV_32FC1)
        ours, valid = lens.sources(*size)
        theirs = torch.from_numpy(np.stack(known, axis=-1)) + 0.5
        found.append(float((ours - theirs).abs().amax(dim=-1)[valid].max()))
    return max(found, default=None)


def dtu(place: Place) -> list[Figure]:
    """A scan with masks, and three edits of it one upon the other."""
    promise = trained(place, DTU, factor=2, minutes=10)
    asset = open_subject(place.folder)
    scene = asset.scene()
    drawn = sequence(asset, scene, edits_for(asset, scene), NAMES)
    holes = [
        Figure(what=f"{one.title}: holes, %", value=rate(one, "hole_rate"), bar=1, at_most=True)
        for one in drawn[1:]
    ]
    return [scored(place, "foreground_psnr", 26.5), *holes, promise]


def beer(place: Place) -> list[Figure]:
    """A can that is cut out automatically, in a room that is folded."""
    promise = trained(place, BEER, factor=4, minutes=10, masks="auto")
    bare = pcore.load_scene(place.data / BEER, factor=4)
    pairs = find_contradictions(ordered_views(bare), locate(bare).region).contradicting
    return [
        scored(place, "foreground_psnr", 25),
        Figure(what="pairs of poses that contradict each other", value=len(pairs), bar=1),
        promise,
    ]


def fox(place: Place) -> list[Figure]:
    """A phone capture without masks, background included."""
    promise = trained(place, FOX, factor=12, minutes=6)
    return [scored(place, "psnr", 32), promise]


def fox_masks(place: Place) -> list[Figure]:
    """The same with automatic masks of the fox."""
    promise = trained(place, FOX, factor=12, minutes=6, masks="auto")
    return [scored(place, "foreground_psnr", 28), promise]


def chair(place: Place) -> list[Figure]:
    """Photos of 400 x 400 pixels and twenty minutes."""
    promise = trained(place, CHAIR, factor=1, minutes=20)
    return [scored(place, "psnr", 34.5), promise]


def checked(place: Place) -> list[Figure]:
    """`pcore check` of a hundred photos."""
    start = processor_seconds()
    command(place, "check", str(place.data / CHAIR))
    seconds = processor_seconds() - start
    return [Figure(what="`check` on 100 views, processor s", value=seconds, bar=30, at_most=True)]


def poses(place: Place) -> list[Figure]:
    """Poses of twenty photos, which COLMAP finds in a process of its own."""
    photos = place.folder / "photos"
    shutil.rmtree(place.folder, ignore_errors=True)  # Poses are kept; here they shall be found.
    photos.mkdir(parents=True)
    every = pictures_in(place.data / BEER / "images")
    for path in every[::3][:_PHOTOS]:
        with Image.open(path) as image:
            image.resize(_SIZE, Image.Resampling.BOX).save(photos / path.name, quality=95)
    start = time.monotonic()
    with patch.dict(os.environ, XDG_CACHE_HOME=str(place.folder / "cache")):
        scene = pcore.load_scene(photos)
    seconds = time.monotonic() - start
    views = len(ordered_views(scene))
    return [
        Figure(what="poses of 20 photos, s", value=seconds, bar=60, at_most=True),
        Figure(what="photos of the largest model", value=views, bar=0.5 * _PHOTOS),
    ]


ROWS: Mapping[str, Callable[[Place], list[Figure]]] = {
    "read": read,
    "poses": poses,
    "check": checked,
    "mesh": mesh,
    "moved": moved,
    "dtu": dtu,
    "beer": beer,
    "fox": fox,
    "fox-masks": fox_masks,
    "chair": chair,
}
"""Cheap rows first."""

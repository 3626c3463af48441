"""Look at a capture before hours are spent on it: poses, photos, masks, region, and the time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from pcore.capture.auto_masks import doubtful, overlap
from pcore.capture.coverage import Coverage, coverage
from pcore.capture.photo_quality import PhotoQuality, photo_quality
from pcore.capture.pose_contradictions import Contradictions, find_contradictions
from pcore.capture.reprojection import Reprojection, reprojection
from pcore.capture.scene_masks import ordered_views, scene_masks
from pcore.capture.triangulation import PoseAgreement
from pcore.capture.voted_hull import hull_silhouettes
from pcore.data.held_cameras import held_cameras
from pcore.data.pictures import to_bytes
from pcore.data.scene import Scene, View
from pcore.errors import DependencyError, InputError
from pcore.evaluation.findings import Finding, findings
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region
from pcore.training.forecast import Forecast, forecasts
from pcore.training.hull import coarse_hull
from pcore.training.locate import Located, Source, locate
from pcore.training.trained_masks import trained_masks

_VOTE, _VOXELS = 0.95, 64
_SIDE = 160
"""Longer side of the masks that are held against one another, pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckedMasks:
    """Masks of all views.

    Attributes:
        masks: (H, W) uint8 of each view; 255 is object.
        agreement: of each with the hull of all, intersection over union.
        automatic: whether they were cut now.
    """

    masks: tuple[Tensor, ...]
    agreement: tuple[float, ...]
    automatic: bool

    def doubtful(self) -> tuple[int, ...]:
        """Numbers of the views whose mask contradicts the others'."""
        return doubtful(self.agreement)


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneCheck:
    """All that was measured of a scene.

    Attributes:
        scene: with masks where it has some.
        views: of all splits of a capture, of `train` otherwise, in the order of their names.
        region: where the object is.
        source: what told so.
        hull: (2, 3) corners of the masks' hull where viewing axes told the region; else None.
        contradictions: of near poses.
        quality: sharpness and exposure.
        coverage: of directions.
        reprojection: of sparse points; None without any.
        agreement: of features with the poses, where points were triangulated by them.
        masks: None where there are none.
        no_masks: why there are none although they were asked for; empty otherwise.
        forecasts: of trainings.
    """

    scene: Scene
    views: tuple[View, ...]
    region: Region
    source: Source
    hull: Tensor | None
    contradictions: Contradictions
    quality: PhotoQuality
    coverage: Coverage
    reprojection: Reprojection | None
    agreement: PoseAgreement | None
    masks: CheckedMasks | None
    no_masks: str
    forecasts: tuple[Forecast, ...]

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What stands out, warnings first."""
        return findings(self)


def check_scene(
    scene: Scene,
    bare: Scene,
    *,
    box: Tensor | None = None,
    automatic: Literal["cut", "trained"] | None = None,
    agreement: PoseAgreement | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> SceneCheck:
    """Measure a scene; nothing is written, and nothing is trained unless masks shall be.

    Args:
        scene: with the masks that it has or is given.
        bare: the same without masks: what is behind the object tells whether poses are right.
        box: (2, 3) corners that the user gives, world units.
        automatic: make masks where the scene has none: cut them out (not to be had without
            OpenCV), or learn the room first (`trained_masks`).
        agreement: of the poses with photos, where that was measured (`triangulated`); the scene's
            points are then of these poses, and their reprojection says nothing.
        progress: told what is done, how much of it, and of how much.

    Raises:
        SceneError: images are damaged, or nothing tells where the object is.
        InputError: a bad box.
    """
    located = locate(scene, box)
    views, whole = ordered_views(scene), ordered_views(bare)
    region = located.region
    masks, why = None, ""
    if all(view.has_alpha for view in views):
        masks = _agreed(views, region, tuple(to_bytes(view.alpha()) for view in views))
    elif automatic is not None:
        masks, why = _automatic(located, whole, automatic, progress)
        if masks is not None:
            located = _with_masks(located, views, masks, box)
            region, views = located.region, ordered_views(located.scene)
    near = find_contradictions(whole, region)
    return SceneCheck(
        scene=scene,
        views=views,
        region=region,
        source=located.source,
        hull=_hull(located) if masks is not None and located.source == "axes" else None,
        contradictions=near,
        quality=photo_quality(whole, near.pairs),
        coverage=coverage(held_cameras(views), region.center),
        reprojection=None
        if scene.sparse is None or agreement is not None
        else reprojection(scene.sparse, whole),
        agreement=agreement,
        masks=masks,
        no_masks=why,
        forecasts=forecasts(located.scene),
    )


def _hull(located: Located) -> Tensor | None:
    """Corners (2, 3) of the hull of the training masks in the region; None of an empty one."""
    voxels, size = coarse_hull(located.scene.split("train"), *located.region.bounds)
    if not len(voxels):
        return None
    return torch.stack([voxels.amin(dim=0) - 0.5 * size, voxels.amax(dim=0) + 0.5 * size])


def _automatic(
    located: Located,
    views: Sequence[View],
    how: Literal["cut", "trained"],
    progress: Callable[[str, int, int], None] | None,
) -> tuple[CheckedMasks | None, str]:
    def tell(done: int, total: int) -> None:
        if progress is not None:
            progress("masks", done, total)

    try:
        if how == "trained":
            made, found = trained_masks(located.scene, progress=tell)
        else:  # As `pcore train` cuts them.
            made, found = scene_masks(
                located.scene, located.region, points=located.points, views=views, progress=tell
            )
    except (DependencyError, InputError) as error:
        return None, str(error)
    row = {view.image.path: number for number, view in enumerate(made)}
    rows = [row[view.image.path] for view in views]
    masks = tuple(found.masks[i] for i in rows)
    if how == "trained":
        return replace(_agreed(views, located.region, masks), automatic=True), ""
    agreement = tuple(found.agreement[i] for i in rows)
    return CheckedMasks(masks=masks, agreement=agreement, automatic=True), ""


def _with_masks(
    located: Located, views: Sequence[View], masks: CheckedMasks, box: Tensor | None
) -> Located:
    """The scene with masks in memory, and its object found by them."""
    known = {id(view): mask for view, mask in zip(views, masks.masks, strict=True)}
    scene = located.scene
    splits = {
        name: tuple(
            _cut_out(view, known[id(view)]) if id(view) in known else view
            for view in scene.split(name)
        )
        for name in scene.splits
    }
    region = scene.region if located.source in ("box", "files") else None
    masked = replace(scene, views=splits, region=region)
    found = locate(masked, box)
    return replace(found, source=located.source) if located.source != "points" else found


def _cut_out(view: View, mask: Tensor) -> View:
    return replace(view, image=replace(view.image, cut=mask))


def _agreed(views: Sequence[View], region: Region, masks: tuple[Tensor, ...]) -> CheckedMasks:
    """How well masks that are there agree with their own hull, looked at small."""
    small = [_small(view, mask) for view, mask in zip(views, masks, strict=True)]
    cameras, bits = [one[0] for one in small], [one[1] for one in small]
    voting = [one for one in small if one[1].any()]  # A lost mask says nothing of the others.
    voters, votes = [one[0] for one in voting], [one[1] for one in voting]
    hulls = hull_silhouettes(voters, votes, region, votes=(_VOTE,), into=cameras, voxels=_VOXELS)[0]
    return CheckedMasks(
        masks=masks,
        agreement=tuple(overlap(a, b) for a, b in zip(bits, hulls, strict=True)),
        automatic=False,
    )


def _small(
    view: View, mask: Tensor
) -> tuple[Camera, np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    scale = min(1.0, _SIDE / max(view.camera.width, view.camera.height))
    size = round(scale * view.camera.height), round(scale * view.camera.width)
    soft = mask[None, None].float() / 255
    alpha = torch.nn.functional.interpolate(soft, size, mode="area")[0, 0]
    return view.camera.resized(size[1], size[0]), (alpha > 0.5).numpy().astype(np.uint8)

"""The pose of an object, from photos of its deformed state with known cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.posing import EditLike, script_of
from pcore.data.scene import View
from pcore.editing.script import EditScript
from pcore.fitting.agreement import Agreement, agreement, check_same_object
from pcore.fitting.fit_config import SEARCHED, FitConfig
from pcore.fitting.fit_photos import Photo, photos_of
from pcore.fitting.fitted_edit import anchor_rig, edit_of, pose_of_edit
from pcore.fitting.fitter import Fitter
from pcore.fitting.part_motion import PartSpace
from pcore.fitting.shown_object import Shown

_WORSE = 0.25
"""Share of the error that limbs which keep their shape may cost."""

Progress = Callable[[int, int], None]
"""Told (steps done, steps in all)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseFit:
    """What a fit found.

    Attributes:
        edit: all anchors as handles; `Asset.pose` of it is what was fitted.
        before: agreement with the photos at the start.
        after: agreement of the edit.
    """

    edit: EditScript
    before: Agreement
    after: Agreement


def fit_pose(
    asset: Asset,
    views: Sequence[View],
    config: FitConfig | None = None,
    *,
    start: EditLike | None = None,
    shown: Shown | None = None,
    progress: Progress | None = None,
) -> PoseFit:
    """Find how an object is posed in photos.

    Positions and turns of few anchors are learned by Adam through the differentiable drawing, from
    small to larger pictures, as rigid as possible; limbs that moved far are found by a search. More
    anchors then follow the largest pictures. Parts that turn out to move as wholes are fitted again
    as such. Gaussians show an object of neural points meanwhile; what is found is kept only if the
    object's own pictures are nearer to the photos than at the start.

    Args:
        asset: the object.
        views: photos of its deformed state with masks; cameras in the world of the asset.
        config: None takes the defaults.
        start: edit to start from; None is the rest state.
        shown: `Shown.of` the object, which takes a minute for neural points; None makes it.
        progress: told now and then.

    Raises:
        InputError: photos without masks, or of another object.
        EditError: a start that does not fit the object, or a pose that folds space.
    """
    config = config or FitConfig()
    shown = shown or Shown.of(asset)
    photos = photos_of(views, shown.gaussians.means.device)
    count = _Count(progress, config.steps)
    coarse, fine = (
        Fitter(shown, anchor_rig(asset.points, asset.rig, config, anchors))
        for anchors in (config.coarse_anchors, config.anchors)
    )
    begun = _numbers(fine, start, asset, config)
    finest = [photo.at_most(config.stages[-1].pixels) for photo in photos]
    before = agreement(asset, fine.posed(begun), finest, silhouettes=config.silhouettes)
    found = _coarse(coarse, _numbers(coarse, start, asset, config), photos, config, count)
    lifted = fine.space.numbers(coarse.at(fine.rig.indices, found))
    small = [photo.at_most(config.stages[config.coarse - 1].pixels) for photo in photos]
    # A start that says more than the coarse anchors can is not given up for what they found.
    numbers = min(begun, lifted, key=lambda one: fine.error(one, small, config))
    if not config.silhouettes:
        by_now = agreement(asset, fine.posed(numbers), small, silhouettes=False)
        check_same_object(by_now, silhouettes=False, coarse=True)
    numbers = fine.through(config.stages[config.coarse :], numbers, photos, config, count)
    if config.parts:
        numbers = rigid_limbs(fine, numbers, photos, config, count)
    after = agreement(asset, fine.posed(numbers), finest, silhouettes=config.silhouettes)
    if after.error > before.error:
        numbers, after = begun, before
    check_same_object(after, silhouettes=config.silhouettes)
    edit = edit_of(fine.space.pose(numbers), config)
    edit.bind(asset.points, rig=asset.rig)  # Whoever draws it refuses an edit that folds space.
    return PoseFit(edit=edit, before=before, after=after)


def _numbers(fitter: Fitter, start: EditLike | None, asset: Asset, config: FitConfig) -> Tensor:
    """Numbers (M, 6) of a pose to start from."""
    if start is None:
        return torch.zeros(len(fitter.space.rest), 6).to(fitter.space.rest)
    given = pose_of_edit(script_of(start), asset.points, fitter.rig, config)
    return fitter.space.numbers(given)


def _coarse(
    fitter: Fitter,
    start: Tensor,
    photos: Sequence[Photo],
    config: FitConfig,
    told: Callable[[], None],
) -> Tensor:
    """Numbers (M, 6) of the pose whose pictures are best after the coarse stages.

    One try follows gradients from the smallest pictures on, one begins with a search; the limbs of
    the better one are searched again.
    """
    stages = config.stages[: config.coarse]
    small = [photo.at_most(stages[-1].pixels) for photo in photos]

    def searched(begin: Tensor, left: int) -> Tensor:
        moved = fitter.searched(begin, photos, config, told)
        return fitter.through(stages[-left:], moved, photos, config, told)

    def error(numbers: Tensor) -> float:
        return fitter.error(numbers, small, config)

    tries = [fitter.through(stages, start, photos, config, told), searched(start, SEARCHED)]
    best = min(tries, key=error)
    return min(best, searched(best, 1), key=error)


def rigid_limbs(
    fitter: Fitter,
    free: Tensor,
    photos: Sequence[Photo],
    config: FitConfig,
    told: Callable[[], None],
) -> Tensor:
    """Numbers (M, 6) of a pose that bends between rigid parts, unless photos speak against it.

    Anchors by themselves follow what photos and drawing differ in, which other views do not share.
    Parts cannot, and turn as wholes where one anchor finds no way.
    """
    begun = fitter.space.pose(free)
    parts = PartSpace.found(fitter.space, begun)
    rigid = fitter.within(parts).through(config.parts, parts.numbers(begun), photos, config, told)
    bent = fitter.space.numbers(parts.pose(rigid))
    bent = fitter.within(parts.jointed()).stage(bent, photos, config.jointed, config, told)
    finest = [photo.at_most(config.jointed.pixels) for photo in photos]
    errors = [fitter.error(each, finest, config) for each in (free, bent)]
    return bent if errors[1] < (1 + _WORSE) * errors[0] else free


class _Count:
    """Tells how many steps of all have been taken."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)

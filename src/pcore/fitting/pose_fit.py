"""The pose of an object of Gaussians, from photos of its deformed state with known cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import MovedPoints
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.posing import EditLike, script_of
from pcore.data.scene import View
from pcore.deform.skinning import AnchorPose, Skinned, SkinningWeights, skin
from pcore.editing.script import EditScript
from pcore.errors import InputError
from pcore.fitting.agreement import Agreement, agreement, check_same_object
from pcore.fitting.anchor_motion import AnchorSpace
from pcore.fitting.fit_config import FitConfig, FitStage
from pcore.fitting.fit_photos import Photo, in_turns, photos_of
from pcore.fitting.fitted_edit import anchor_rig, edit_of, pose_of_edit
from pcore.gaussians.carry import carried_axes
from pcore.gaussians.render import Footprint, PosedGaussians, render
from pcore.geometry.local_maps import LocalMaps

Progress = Callable[[int, int], None]
"""Told (steps done, steps in all)."""

_BETAS = (0.9, 0.98)
_SLOWEST = 0.05
_UPRIGHT = 0.2
"""Determinants of local maps below this are pushed up, so that the edit folds nothing."""


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
    progress: Progress | None = None,
) -> PoseFit:
    """Find how an object is posed in photos.

    Positions and turns of anchors are learned by Adam through the differentiable drawing, from
    small to larger pictures, as rigid as possible.

    Args:
        asset: an object of Gaussians.
        views: photos of its deformed state with masks; cameras in the world of the asset.
        config: None takes the defaults.
        start: edit to start from; None is the rest state.
        progress: told now and then.

    Raises:
        InputError: an object of neural points, photos without masks, or of another object.
        EditError: a start that does not fit the object, or a pose that folds space.
    """
    config = config or FitConfig()
    content = gaussian_content(asset)
    photos = photos_of(views, content.gaussians.means.device)
    rig = anchor_rig(asset.points, asset.rig, config)
    fitter = _Fitter(
        content, AnchorSpace.of(rig.graph, content.gaussians.means.device), rig.weights
    )
    numbers = fitter.space.rest.new_zeros(len(fitter.space.rest), 6)
    if start is not None:
        given = pose_of_edit(script_of(start), asset.points, rig, config)
        numbers = fitter.space.numbers(given)
    finest = [photo.at_most(config.stages[-1].pixels) for photo in photos]
    before = fitter.agreement(numbers, finest)
    count = _Count(progress, config.steps)
    tries = [
        fitter.through(config.stages[first : config.coarse], numbers, photos, config, count)
        for first in range(config.tries)
    ]
    small = [photo.at_most(config.stages[config.coarse - 1].pixels) for photo in photos]
    numbers = min(tries, key=lambda found: fitter.error(found, small, config))
    numbers = fitter.through(config.stages[config.coarse :], numbers, photos, config, count)
    after = fitter.agreement(numbers, finest)
    check_same_object(after, silhouettes=config.silhouettes)
    edit = edit_of(fitter.space.pose(numbers), config)
    edit.bind(asset.points, rig=asset.rig)  # Whoever draws it refuses an edit that folds space.
    return PoseFit(edit=edit, before=before, after=after)


def gaussian_content(asset: Asset) -> GaussianContent:
    """Return the Gaussians of an asset.

    Raises:
        InputError: it is made of neural points.
    """
    content = asset.content
    if not isinstance(content, GaussianContent):
        raise InputError(
            "fit: expected an object of Gaussians, got one of neural points; train one with "
            "`pcore train SCENE --model gaussians`"
        )
    return content


class _Count:
    """Tells how many steps of all have been taken."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self._total)


class _Fitter:
    """What does not change while a pose is learned."""

    def __init__(
        self, content: GaussianContent, space: AnchorSpace, weights: SkinningWeights
    ) -> None:
        self.content, self.space = content, space
        self._gaussians = content.gaussians.detached()
        device = self._gaussians.means.device
        self._weights = SkinningWeights(
            anchors=weights.anchors.to(device), values=weights.values.detach().to(device).float()
        )

    def skinned(self, pose: AnchorPose) -> Skinned:
        return skin(self._gaussians.means, self._weights, pose)

    @torch.no_grad()
    def look(self, numbers: Tensor) -> PosedGaussians:
        """The object as `Asset.pose` draws it: colours turned along, light standing still."""
        moved = self.skinned(self.space.pose(numbers))
        maps = LocalMaps(to_rest=torch.linalg.inv(moved.linear.double()).float().cpu())
        motion = MovedPoints(positions=moved.positions.cpu(), local_maps=maps)
        return self.content.pose(motion, rays="aware", light=None).drawn

    def agreement(self, numbers: Tensor, photos: Sequence[Photo]) -> Agreement:
        return agreement(self.look(numbers), photos, self.content.footprint)

    def drawn(self, moved: Skinned, look: PosedGaussians) -> PosedGaussians:
        """Gaussians with gradients to where they are; colours and light as they were last."""
        shape = replace(self._gaussians, means=moved.positions, sh=look.gaussians.sh)
        axes = carried_axes(self._gaussians, moved.linear)
        return PosedGaussians(gaussians=shape, axes=axes, gains=look.gains)

    def through(
        self,
        stages: Sequence[FitStage],
        numbers: Tensor,
        photos: Sequence[Photo],
        config: FitConfig,
        told: Callable[[], None],
    ) -> Tensor:
        """Numbers (M, 6) after stages."""
        for stage in stages:
            numbers = self.stage(numbers, photos, stage, config, told)
        return numbers

    def stage(
        self,
        start: Tensor,
        photos: Sequence[Photo],
        stage: FitStage,
        config: FitConfig,
        told: Callable[[], None],
    ) -> Tensor:
        """Numbers (M, 6) after a stage, or those before it if they fit its photos better."""
        small = [photo.at_most(stage.pixels) for photo in photos]
        smoother = self.space.smoother(stage.spread)
        spread = torch.linalg.inv(smoother)
        latent = (smoother @ start).requires_grad_(True)
        optimizer = torch.optim.Adam([latent], lr=stage.rate, betas=_BETAS)
        turns = in_turns(small, config.views, config.seed)
        draw = torch.Generator().manual_seed(config.seed)
        look = self.look(start)
        for step in range(stage.steps):
            share = step / stage.steps
            optimizer.param_groups[0]["lr"] = stage.rate * max(_SLOWEST, 1 - share**2)
            if step % config.relight == config.relight - 1:
                look = self.look(spread @ latent.detach())
            pose = self.space.pose(spread @ latent)
            moved = self.skinned(pose)
            background = torch.rand(3, generator=draw).to(latent)
            loss = picture_loss(
                self.drawn(moved, look),
                next(turns),
                background,
                footprint=self.content.footprint,
                silhouettes=config.silhouettes,
            )
            folds = (_UPRIGHT - torch.linalg.det(moved.linear)).clamp_min(0).mean()
            optimizer.zero_grad()
            (loss + stage.stiffness * self.space.bending(pose) + folds).backward()
            optimizer.step()
            told()
        found = (spread @ latent).detach()
        errors = [self.error(each, small, config) for each in (start, found)]
        return found if errors[1] < errors[0] else start

    @torch.no_grad()
    def error(self, numbers: Tensor, photos: Sequence[Photo], config: FitConfig) -> float:
        """Error of all photos before white."""
        return float(
            picture_loss(
                self.look(numbers),
                photos,
                numbers.new_ones(3),
                footprint=self.content.footprint,
                silhouettes=config.silhouettes,
            )
        )


def picture_loss(
    posed: PosedGaussians,
    photos: Sequence[Photo],
    background: Tensor,
    *,
    footprint: Footprint,
    silhouettes: bool,
) -> Tensor:
    """Mean absolute error of colours and opacities, by the area of the object in the photos.

    Args:
        posed: what is drawn.
        photos: to compare with.
        background: (3,) colour that both stand before.
        footprint: as the Gaussians were trained.
        silhouettes: leave the colours out.
    """
    errors, area = background.new_zeros(()), background.new_zeros(())
    for photo in photos:
        seen = render(posed, [photo.camera], footprint=footprint, background=background)
        error = (seen.alpha[0] - photo.alpha).abs()
        if not silhouettes:
            error = error + (seen.rgb[0] - photo.over(background)).abs().mean(dim=-1)
        errors = errors + (error * photo.known).sum()
        area = area + (photo.alpha * photo.known).sum()
    return errors / area.clamp_min(1)

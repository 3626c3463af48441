"""What learns a pose through the differentiable drawing of Gaussians."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from pcore.asset.asset import Posed
from pcore.asset.content import MovedPoints
from pcore.deform.skinning import AnchorPose, Skinned, SkinningWeights, skin
from pcore.editing.anchors import AnchorRig
from pcore.fitting.agreement import difference
from pcore.fitting.anchor_motion import AnchorSpace
from pcore.fitting.fit_config import FitConfig, FitStage
from pcore.fitting.fit_photos import Photo, in_turns
from pcore.fitting.limb_search import LimbSearch
from pcore.fitting.point_splatting import PointSplatting
from pcore.fitting.shown_object import Shown
from pcore.gaussians.carry import carried_axes
from pcore.gaussians.render import Footprint, PosedGaussians
from pcore.gaussians.wide_pixels import render_divided
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.rotation import nearest_rotation

_BETAS = (0.9, 0.98)
_SLOWEST = 0.05
_UPRIGHT = 0.2
"""Determinants of local maps below this are pushed up, so that the edit folds nothing."""


class Fitter:
    """What does not change while a pose is learned."""

    def __init__(self, shown: Shown, rig: AnchorRig) -> None:
        self.shown, self.rig, self._gaussians = shown, rig, shown.gaussians
        device = self._gaussians.means.device
        self.space = AnchorSpace.of(rig.graph, device)
        self._points = shown.asset.points.to(device)
        self._of_points = SkinningWeights(
            anchors=rig.weights.anchors.to(device),
            values=rig.weights.values.detach().to(device).float(),
        )
        self._weights = SkinningWeights(
            anchors=shown.rows(self._of_points.anchors), values=shown.rows(self._of_points.values)
        )

    def within(self, space: AnchorSpace) -> Fitter:
        """Return the same with other numbers that say how its anchors move."""
        other = copy.copy(self)
        other.space = space
        return other

    def skinned(self, pose: AnchorPose) -> Skinned:
        """The Gaussians as a pose carries them."""
        return skin(self._gaussians.means, self._weights, pose)

    @torch.no_grad()
    def posed(self, numbers: Tensor) -> Posed:
        """The object under numbers (M, 6), its light standing still, whether it folds or not."""
        moved = skin(self._points, self._of_points, self.space.pose(numbers))
        maps = LocalMaps(to_rest=torch.linalg.inv(moved.linear.double()).float().cpu())
        return self.shown.asset.pose(MovedPoints(positions=moved.positions.cpu(), local_maps=maps))

    def look(self, numbers: Tensor) -> PosedGaussians:
        """The Gaussians that show the object under numbers (M, 6): colours turned along, lit."""
        return self.shown.look(self.posed(numbers))

    def drawn(self, moved: Skinned, look: PosedGaussians) -> PosedGaussians:
        """Gaussians with gradients to where they are; colours and light as they were last."""
        shape = replace(self._gaussians, means=moved.positions, sh=look.gaussians.sh)
        axes = carried_axes(self._gaussians, moved.linear)
        return PosedGaussians(gaussians=shape, axes=axes, turns=look.turns, gains=look.gains)

    def at(self, indices: Tensor, numbers: Tensor) -> AnchorPose:
        """How points (K,) by their indices move under numbers (M, 6)."""
        moved = skin(self._points, self._of_points, self.space.pose(numbers))
        indices = indices.to(numbers.device)
        return AnchorPose(
            rest=self._points[indices],
            moved=moved.positions[indices],
            rotations=nearest_rotation(moved.linear[indices]),
        )

    def searched(
        self,
        start: Tensor,
        photos: Sequence[Photo],
        config: FitConfig,
        told: Callable[[], None],
    ) -> Tensor:
        """Numbers (M, 6) with limbs swung to where small pictures are best."""
        small = [photo.at_most(config.search.pixels) for photo in photos]
        look, white = self.look(start), start.new_ones(3)
        splatting = PointSplatting.of(
            look,
            self._gaussians.means,
            self._weights,
            small,
            count=config.search.points,
            seed=config.seed,
            silhouettes=config.silhouettes,
        )

        @torch.no_grad()
        def error(pose: AnchorPose) -> float:
            drawn = self.drawn(self.skinned(pose), look)
            return float(self._loss(drawn, small, white, config))

        search = LimbSearch(
            graph=self.rig.graph,
            splatting=splatting,
            error=error,
            sweeps=config.search.sweeps,
            seed=config.seed,
        )
        return self.space.numbers(search.found(self.space.pose(start), told))

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
            loss = self._loss(self.drawn(moved, look), next(turns), background, config)
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
        return float(self._loss(self.look(numbers), photos, numbers.new_ones(3), config))

    def _loss(
        self, drawn: PosedGaussians, photos: Sequence[Photo], background: Tensor, config: FitConfig
    ) -> Tensor:
        return picture_loss(
            drawn,
            photos,
            background,
            footprint=self.shown.footprint,
            silhouettes=config.silhouettes,
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
        seen = render_divided(posed, [photo.camera], footprint=footprint, background=background)
        one = seen.rgb[0], seen.alpha[0]
        errors = errors + difference(*one, photo, background, silhouettes=silhouettes)
        area = area + (photo.alpha * photo.known).sum()
    return errors / area.clamp_min(1)

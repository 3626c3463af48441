"""The objective of fine-tuning: L_rgb + lambda_geo L_geo + lambda_tex L_tex (paper)."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from pcore.data.scene import View
from pcore.deform.base import Deformation
from pcore.deform.sampler import sample_deformation
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.training.config import FinetuneConfig
from pcore.training.consistency import (
    Canonical,
    canonical_of,
    consistency,
    points_only_rays,
    rays_and_points_rays,
)
from pcore.training.loop import autocast
from pcore.training.losses import Losses, Perceptual, mean_of, photometric, training_image
from pcore.training.patches import Patch, draw_patch
from pcore.training.random_motion import FieldMotion, Motion, SkinnedMotion
from pcore.training.ranks import current_ranks
from pcore.training.trainable import Trainable
from pcore.training.trained import Trained


class Objective:
    """The losses of one patch: canonical pass, random field, both modes."""

    def __init__(
        self,
        config: FinetuneConfig,
        work: Trainable,
        base: Trained,
        perceptual: Perceptual | None,
    ) -> None:
        self._config, self._work, self._perceptual = config, work, perceptual
        lower, upper = base.cloud.extent()
        self._lower, self._upper = lower.cpu(), upper.cpu()
        self._points = base.cloud.positions.cpu()
        self._unit = float((upper - lower).norm())
        self._move = _motion(config, work, self._unit)

    def field(self) -> Deformation:
        """Draw a field for a patch."""
        return sample_deformation(
            self._work.generator, self._lower, self._upper, self._points, self._config.ranges
        )

    def of_step(self, views: Sequence[View]) -> Losses:
        """Draw patches of views and a field for each, and compare; as `__call__`, the mean.

        All processes draw all of them, so that they go on drawing alike.
        """
        config, generator = self._config, self._work.generator
        where = self._work.cloud.positions.device
        batch = [
            (draw_patch(views, config.patch, config.background, generator, where), self.field())
            for _ in range(config.patch.views)
        ]
        found: list[Losses] = []
        for patch, field in current_ranks().share(batch):
            with autocast(where, enabled=config.mixed_precision):
                found.append(self(patch, field))
        return mean_of(found, of=len(batch))

    def __call__(self, patch: Patch, deformation: Deformation) -> Losses:
        """L_rgb + lambda_geo L_geo + lambda_tex L_tex of a patch (paper, "Joint Loss")."""
        config, work = self._config, self._work
        posed = PosedCloud.at_rest(work.cloud)
        image = training_image(work.papr, posed, patch.rays, patch.background)
        photo = photometric(
            image,
            patch,
            opacity_weight=config.opacity_weight,
            lpips_weight=config.lpips_weight,
            perceptual=self._perceptual,
            front_weight=config.front_weight / work.papr.config.unit**2,
        )
        rgb = image.rgb
        if config.texture_target == "photo" and patch.valid is not None:
            rgb = torch.where(patch.valid[..., None], patch.rgb, rgb)
        elif config.texture_target == "photo":
            rgb = patch.rgb
        canonical = canonical_of(image, work.cloud, patch.rays, rgb, config.foreground_alpha)
        moved = self._move(work.cloud, canonical, deformation)
        terms = {**photo.terms, **moved.terms}
        for name, rays in self._modes(patch.rays, canonical, deformation).items():
            found = consistency(
                training_image(work.papr, moved.posed, rays, patch.background),
                canonical,
                moved.surface,
                unit=self._unit,
                background_rays=config.background_rays,
            )
            terms[f"geo_{name}"] = config.geometry_weight * found.geometry
            terms[f"tex_{name}"] = config.texture_weight * found.texture
        return Losses(terms=terms, squared_error=photo.squared_error)

    def _modes(
        self, rays: RayBundle, canonical: Canonical, deformation: Deformation
    ) -> dict[str, RayBundle]:
        """Deformed rays of the modes that this step uses, by name."""
        config = self._config
        both = config.points_only and config.rays_and_points
        turn = self._work.step % 2 if config.alternate and both else None
        modes: dict[str, RayBundle] = {}
        if config.points_only and turn != 1:
            modes["points"] = points_only_rays(rays, canonical, deformation)
        if config.rays_and_points and turn != 0:
            modes["rays"] = rays_and_points_rays(
                rays,
                canonical,
                deformation,
                config.origin_distance,
                keep_distance=config.keep_distance,
            )
        return modes


def _motion(config: FinetuneConfig, work: Trainable, unit: float) -> Motion:
    """What moves points and surface points: the field itself, or the skinning where one learns."""
    if config.skinning is None or work.skinning is None:
        return FieldMotion(aware=config.aware)
    return SkinnedMotion(
        skinning=work.skinning,
        prior=work.skinning.prior(work.cloud.positions),
        config=config.skinning,
        unit=unit,
        aware=config.aware,
    )

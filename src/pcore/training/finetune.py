"""P-CORE: fine-tune the attention so that its surface commutes with deformation."""

from __future__ import annotations

import copy

import torch
from torch import Tensor

from pcore.data.scene import Scene, hold_out
from pcore.deform.base import Deformation
from pcore.deform.sampler import sample_deformation
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Rendering
from pcore.training.config import FinetuneConfig
from pcore.training.consistency import (
    Canonical,
    Consistency,
    canonical_of,
    consistency,
    points_only_rays,
    rays_and_points_rays,
)
from pcore.training.events import Listener, silent
from pcore.training.loop import Plan, autocast, run_loop
from pcore.training.losses import Losses, Perceptual, perceptual_loss, photometric
from pcore.training.output import RunFolder
from pcore.training.patches import Patch, draw_patch
from pcore.training.pretrain import mean_of
from pcore.training.trainable import Trainable, trainable
from pcore.training.trained import Trained
from pcore.training.validation import validate


def finetune(
    scene: Scene,
    base: Trained,
    config: FinetuneConfig,
    *,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
) -> Trained:
    """Fine-tune a pre-trained model with random deformations; no image of a deformed state is used.

    Args:
        scene: the one it was trained on; only training views are used.
        base: the pre-trained model; left as it is.
        config: losses, modes, schedule.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: "cpu", "cuda", ...

    Returns:
        The tuned model.

    Raises:
        WeightsError: LPIPS was asked for and its weights are missing.
        TrainingError: diverged or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    where = torch.device(device)
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    perceptual = perceptual_loss(config.lpips_weight, config.lpips_trunk, where)
    anchor = _moved(base, where)
    work = trainable(
        "finetune",
        copy.deepcopy(anchor.papr).train(),
        anchor.cloud,
        seed=config.seed,
        train_points=config.train_points,
    )
    if config.largest_loss is not None:
        work.best = {"weights": work.weights()}
    steps = _Steps(config, work, anchor, perceptual)

    def losses() -> Losses:
        found: list[Losses] = []
        for _ in range(config.patch.views):
            patch = draw_patch(views, config.patch, config.background, work.generator, where)
            with autocast(where, enabled=config.mixed_precision):
                found.append(steps.losses(patch))
        return mean_of(found)

    return run_loop(
        work,
        Plan(
            steps=config.steps,
            rates=config.rates,
            validate_every=config.validate_every,
            save_every=config.save_every,
            average=config.average,
            validation=validation,
            background=config.background,
            scene=scene.name,
        ),
        losses,
        accept=_guard(anchor, validation, config),
        folder=folder,
        listener=listener,
    )


def _moved(base: Trained, device: torch.device) -> Trained:
    cloud = base.cloud.detached()
    return Trained(
        papr=copy.deepcopy(base.papr).to(device).requires_grad_(False).eval(),
        cloud=PointCloud(
            positions=cloud.positions.to(device),
            features=cloud.features.to(device),
            influence=cloud.influence.to(device),
        ),
        step=base.step,
    )


def _guard(anchor: Trained, validation: object, config: FinetuneConfig):  # noqa: ANN202
    if config.largest_loss is None:
        return lambda psnr: True
    start = validate(anchor, validation, config.background)["psnr"]  # type: ignore[arg-type]
    return lambda psnr: psnr >= start - config.largest_loss


class _Steps:
    """The losses of one patch: canonical pass, random field, both modes."""

    def __init__(
        self,
        config: FinetuneConfig,
        work: Trainable,
        anchor: Trained,
        perceptual: Perceptual | None,
    ) -> None:
        self._config, self._work, self._anchor = config, work, anchor
        self._perceptual = perceptual
        lower, upper = anchor.cloud.extent()
        self._lower, self._upper = lower.cpu(), upper.cpu()
        self._points = anchor.cloud.positions.cpu()
        self._unit = float((upper - lower).norm())

    def losses(self, patch: Patch) -> Losses:
        """L_rgb + lambda_geo L_geo + lambda_tex L_tex of a patch (paper, "Joint Loss")."""
        config, work = self._config, self._work
        rendering = work.papr(work.cloud, patch.rays, patch.background)
        canonical_loss = photometric(
            rendering,
            patch,
            opacity_weight=config.opacity_weight,
            lpips_weight=config.lpips_weight,
            perceptual=self._perceptual,
        )
        canonical = self._canonical(rendering, patch)
        deformation = sample_deformation(
            work.generator, self._lower, self._upper, self._points, config.ranges
        )
        terms = dict(canonical_loss.terms)
        for name, rays in self._modes(patch, canonical, deformation).items():
            found = self._consistency(rays, canonical, deformation, patch.background)
            terms[f"geo_{name}"] = config.geometry_weight * found.geometry
            terms[f"tex_{name}"] = config.texture_weight * found.texture
        return Losses(terms=terms, squared_error=canonical_loss.squared_error)

    def _canonical(self, rendering: Rendering, patch: Patch) -> Canonical:
        config = self._config
        if config.anchor:
            with torch.no_grad():
                rendering = self._anchor.papr(self._anchor.cloud, patch.rays, patch.background)
        rgb = patch.rgb if config.texture_target == "photo" else rendering.rgb
        return canonical_of(
            rendering, self._work.cloud, patch.rays, rgb, config.foreground_alpha
        )

    def _modes(self, patch: Patch, canonical: Canonical, deformation: Deformation):  # noqa: ANN202
        config = self._config
        both = config.points_only and config.rays_and_points
        turn = self._work.step % 2 if config.alternate and both else None
        modes = {}
        if config.points_only and turn != 1:
            modes["points"] = points_only_rays(patch.rays, canonical, deformation)
        if config.rays_and_points and turn != 0:
            modes["rays"] = rays_and_points_rays(
                patch.rays, canonical, deformation, config.origin_distance
            )
        return modes

    def _consistency(
        self, rays, canonical: Canonical, deformation: Deformation, background: Tensor  # noqa: ANN001
    ) -> Consistency:
        work = self._work
        return consistency(
            work.papr,
            work.cloud.moved(deformation(work.cloud.positions)),
            rays,
            canonical,
            deformation,
            unit=self._unit,
            background=background,
            background_rays=self._config.background_rays,
        )

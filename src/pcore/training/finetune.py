"""P-CORE: fine-tune the attention so that its surface commutes with deformation."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import torch

from pcore.data.scene import Scene, View, check_images, hold_out
from pcore.deform.base import Deformation
from pcore.deform.local_frames import unchecked_frames
from pcore.deform.sampler import sample_deformation
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Rendering
from pcore.training.config import FinetuneConfig
from pcore.training.consistency import (
    Canonical,
    canonical_of,
    consistency,
    points_only_rays,
    rays_and_points_rays,
)
from pcore.training.events import Listener, silent
from pcore.training.loop import Plan, autocast, run_loop
from pcore.training.losses import Losses, Perceptual, mean_of, perceptual_loss, photometric
from pcore.training.output import RunFolder
from pcore.training.patches import Patch, draw_patch
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
    check_images(scene.split("train"))
    anchor = _moved(base, where)
    work = trainable(
        "finetune",
        copy.deepcopy(anchor.papr).train(),
        anchor.cloud,
        seed=config.seed,
        train_points=config.train_points,
    )
    if config.largest_loss is not None and validation:
        work.best = {"weights": {name: t.clone() for name, t in work.weights().items()}}
    objective = _Objective(config, work, anchor, perceptual)

    def losses() -> Losses:
        found: list[Losses] = []
        for _ in range(config.patch.views):
            patch = draw_patch(views, config.patch, config.background, work.generator, where)
            with autocast(where, enabled=config.mixed_precision):
                found.append(objective(patch))
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
    return Trained(
        papr=copy.deepcopy(base.papr).to(device).requires_grad_(False).eval(),
        cloud=base.cloud.detached().to(device),
        step=base.step,
    )


def _guard(
    anchor: Trained, validation: Sequence[View], config: FinetuneConfig
) -> Callable[[float], bool]:
    """Say whether a validation's PSNR is near enough to that before fine-tuning."""
    if config.largest_loss is None or not validation:
        return lambda psnr: True
    least = validate(anchor, validation, config.background)["psnr"] - config.largest_loss
    return lambda psnr: psnr >= least


class _Objective:
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

    def __call__(self, patch: Patch) -> Losses:
        """L_rgb + lambda_geo L_geo + lambda_tex L_tex of a patch (paper, "Joint Loss")."""
        config, work = self._config, self._work
        rendering = work.papr(work.cloud, patch.rays, patch.background)
        photo = photometric(
            rendering,
            patch,
            opacity_weight=config.opacity_weight,
            lpips_weight=config.lpips_weight,
            perceptual=self._perceptual,
            front_weight=config.front_weight,
        )
        canonical = self._canonical(rendering, patch)
        deformation = sample_deformation(
            work.generator, self._lower, self._upper, self._points, config.ranges
        )
        positions = work.cloud.positions
        frames = unchecked_frames(deformation, positions) if config.aware else None
        deformed = work.cloud.moved(deformation(positions), frames)
        terms = dict(photo.terms)
        for name, rays in self._modes(patch.rays, canonical, deformation).items():
            found = consistency(
                work.papr(deformed, rays, patch.background),
                canonical,
                deformation,
                unit=self._unit,
                background_rays=config.background_rays,
            )
            terms[f"geo_{name}"] = config.geometry_weight * found.geometry
            terms[f"tex_{name}"] = config.texture_weight * found.texture
        return Losses(terms=terms, squared_error=photo.squared_error)

    def _canonical(self, rendering: Rendering, patch: Patch) -> Canonical:
        config = self._config
        if config.anchor:
            with torch.no_grad():
                rendering = self._anchor.papr(self._anchor.cloud, patch.rays, patch.background)
        rgb = patch.rgb if config.texture_target == "photo" else rendering.rgb
        return canonical_of(rendering, self._work.cloud, patch.rays, rgb, config.foreground_alpha)

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

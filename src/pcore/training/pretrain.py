"""Pre-training of PAPR on the photos of one scene."""

from __future__ import annotations

import dataclasses
import statistics
import time
from collections.abc import Sequence

import torch
from torch import Tensor

from pcore.data.masks import check_masks
from pcore.data.scene import Scene, View, check_images, hold_out
from pcore.errors import TrainingError
from pcore.files.run_folder import RunFolder
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.model.papr_config import COLOR_CHANNELS, PaprConfig, ReferenceOrigin
from pcore.training.compiling import compile_networks
from pcore.training.config import GrowConfig, PretrainConfig, PruneConfig
from pcore.training.events import Listener, PopulationReport, silent
from pcore.training.exposure import ViewExposure
from pcore.training.gaussian_start import mean_colors
from pcore.training.loop import autocast, run_loop
from pcore.training.loop_plan import Plan
from pcore.training.losses import (
    Losses,
    Perceptual,
    mean_of,
    perceptual_loss,
    photometric,
    training_image,
)
from pcore.training.near_origin import in_frame, moved_config, near_origin, network_frame
from pcore.training.pace import Clock, Pace
from pcore.training.patches import draw_patch
from pcore.training.population import growth_mixture, growth_sites, replace_rows
from pcore.training.ranks import current_ranks
from pcore.training.reduced_view import Photo, PhotosInTurn
from pcore.training.schedule import reduction_at
from pcore.training.start_cloud import start_positions
from pcore.training.trainable import Trainable, trainable
from pcore.training.trained import Trained


def pretrain(
    scene: Scene,
    config: PretrainConfig,
    *,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
    compiled: bool = True,
    clock: Clock = time.monotonic,
) -> Trained:
    """Learn points and attention from the training views.

    Args:
        scene: its `train` split is used, nothing else; every `hold_out`-th view only validates.
        config: architecture and schedule.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: "cpu", "cuda", ...
        compiled: use torch.compile where it pays, on a GPU.
        clock: tells the time to a training that has promised one.

    Returns:
        The networks and the canonical points.

    Raises:
        SceneError: an image is damaged, or no mask holds anything.
        InputError: the scene has no silhouettes for a visual hull, or a bad starting cloud.
        WeightsError: LPIPS was asked for and its weights are missing.
        TrainingError: diverged, ran out of points, cannot be compiled or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    where = torch.device(device)
    perceptual = perceptual_loss(config.lpips_weight, config.lpips_trunk, where)
    scene, origin = near_origin(scene)
    check_images(scene.split("train"))
    check_masks(scene.split("train"))
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    work = begin(scene, views, config, where, origin)
    pace = Pace.of(config, seconds=config.seconds, clock=clock)
    photos = PhotosInTurn(views)
    exposure = ViewExposure(len(views), where) if config.exposure else None
    work.fits_exposure = exposure is not None
    if compiled:
        compile_networks(where, work.papr.unet, perceptual)

    def losses() -> Losses:
        shown = photos.at(reduction_at(config.levels, pace.progress(work.step)))
        return patch_losses(work, shown, config, perceptual, exposure)

    return run_loop(
        work,
        Plan.of(config, validation, scene.name, pace=pace, exposure=exposure),
        losses,
        after_step=lambda tell: _change_population(work, config, tell),
        finish=lambda tell: work.complete(scene.split("train"), tell),
        folder=folder,
        listener=listener,
    )


def patch_losses(
    work: Trainable,
    views: Sequence[Photo],
    config: PretrainConfig,
    perceptual: Perceptual | None = None,
    exposure: ViewExposure | None = None,
) -> Losses:
    """Draw the patches of the coming step and compare them with what the work shows there."""
    where = work.cloud.positions.device
    patches = [
        draw_patch(views, config.patch, config.background, work.generator, where)
        for _ in range(config.patch.views)
    ]
    found: list[Losses] = []
    for patch in current_ranks().share(patches):
        with autocast(where, enabled=config.mixed_precision):
            posed = PosedCloud.at_rest(work.cloud)
            image = training_image(work.papr, posed, patch.rays, patch.background)
        if exposure is not None:
            rgb = exposure.applied(patch.view, image.rgb, image.alpha, patch.background)
            image = dataclasses.replace(image, rgb=rgb)
        found.append(
            photometric(
                image,
                patch,
                opacity_weight=config.opacity_weight,
                lpips_weight=config.lpips_weight,
                perceptual=perceptual,
                front_weight=config.front_weight / work.papr.config.unit**2,
            )
        )
    return mean_of(found, of=len(patches))


def begin(
    scene: Scene,
    views: Sequence[View],
    config: PretrainConfig,
    device: torch.device,
    origin: Tensor | None = None,
) -> Trainable:
    """Networks and points before the first step; see `Trainable` for the origin of the scene."""
    model = _model_config(config, scene, origin)
    # Weights come from torch's global generator; fork it so that the library leaves it alone.
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        papr = Papr(model)
        generator = torch.Generator().manual_seed(config.seed)
        positions = start_positions(scene, views, config, model.frame, generator, origin)
        features = torch.randn(len(positions), papr.config.feature_size, generator=generator)
    features = config.feature_spread * features
    if model.point_colors:
        features[:, : model.color_features] = 0
        features[:, :COLOR_CHANNELS] = mean_colors(positions, views)
    cloud = PointCloud(
        positions=positions.to(device),
        features=features.to(device),
        influence=torch.full((len(positions),), config.influence_start, device=device),
    )
    work = trainable("pretrain", papr.to(device), cloud, seed=config.seed + 1)
    work.origin = origin
    return work


def _model_config(config: PretrainConfig, scene: Scene, origin: Tensor | None) -> PaprConfig:
    color = (0.0, 0.0, 0.0) if config.background == "black" else (1.0, 1.0, 1.0)
    reference = None
    if config.origin == "reference":
        x, y, z = scene.center.tolist()
        reference = ReferenceOrigin(center=(x, y, z), distance=scene.radius)
    # The original draws pictures of any size as they come, and so do its settings.
    widths = [view.camera.pixel_width(scene.center) for view in scene.split("train")]
    pixel = statistics.median(widths) if config.model.samples > 1 else None
    model = dataclasses.replace(config.model, background=color, reference=reference, pixel=pixel)
    if model.frame is None:
        return in_frame(model, network_frame(scene))
    # What a user gives is in the world.
    return (
        model
        if origin is None
        else dataclasses.replace(model, frame=moved_config(model, -origin).frame)
    )


def _due(step: int, when: PruneConfig | GrowConfig) -> bool:
    return when.first <= step <= when.last and step % when.every == 0


def _change_population(work: Trainable, config: PretrainConfig, listener: Listener) -> None:
    pruned = grown = 0
    if config.prune is not None and _due(work.step, config.prune):
        pruned = _prune(work, config.prune)
    if config.grow is not None and _due(work.step, config.grow):
        grown = _grow(work, config.grow)
    if pruned or grown:
        points = len(work.cloud)
        listener(
            PopulationReport(
                stage=work.stage, step=work.step, pruned=pruned, grown=grown, points=points
            )
        )


def _prune(work: Trainable, config: PruneConfig) -> int:
    threshold = config.threshold_at(work.step)
    keep = work.cloud.influence.detach() > threshold
    kept = int(keep.sum())
    if kept == 0:
        raise TrainingError(
            f"pruning at step {work.step}: no point has an influence above {threshold}, the "
            "cloud would be empty; prune later, lower the threshold or the learning rates"
        )
    if kept < len(work.cloud):
        _replace(work, keep, {name: t[:0] for name, t in _tensors(work.cloud).items()})
    return len(keep) - kept


def _grow(work: Trainable, config: GrowConfig) -> int:
    count = min(config.count, config.limit - len(work.cloud))
    if count <= 0:
        return 0
    positions = work.cloud.positions.detach()
    parents, weights = growth_mixture(positions, growth_sites(positions, count), work.generator)
    new = {
        name: torch.einsum("ap,ap...->a...", weights, tensor[parents])
        for name, tensor in _tensors(work.cloud).items()
    }
    _replace(work, torch.ones(len(positions), dtype=torch.bool, device=positions.device), new)
    return count


def _tensors(cloud: PointCloud) -> dict[str, Tensor]:
    return {
        "positions": cloud.positions.detach(),
        "features": cloud.features.detach(),
        "influence": cloud.influence.detach(),
    }


def _replace(work: Trainable, keep: Tensor, new: dict[str, Tensor]) -> None:
    work.cloud = PointCloud.from_tensors(
        {
            name: replace_rows(work.optimizer, getattr(work.cloud, name), keep, rows)
            for name, rows in new.items()
        }
    )

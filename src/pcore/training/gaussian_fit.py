"""Training of Gaussians on the photos of one scene (Kerbl et al. 2023)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from pcore.data.images import background_color, composite
from pcore.data.scene import Scene, check_images, hold_out
from pcore.errors import TrainingError
from pcore.files.run_folder import RunFolder
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import GaussianPictures, PosedGaussians, render_views, view_matrices
from pcore.geometry.camera import Camera
from pcore.training.events import Listener, PopulationReport, silent
from pcore.training.exposure import ViewExposure
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from pcore.training.gaussian_density import changes
from pcore.training.gaussian_start import camera_distance, start_gaussians
from pcore.training.loop import run_loop
from pcore.training.loop_plan import Plan
from pcore.training.losses import Losses, mean_of
from pcore.training.pace import Clock, Leg, Pace
from pcore.training.ranks import Ranks, current_ranks
from pcore.training.reduced_view import Photo, PhotosInTurn
from pcore.training.schedule import Level, reduction_at
from pcore.training.speed import Speed
from pcore.training.ssim import picture_losses
from pcore.training.trainable_gaussians import (
    Bound,
    TrainableGaussians,
    TrainedGaussians,
    trainable_gaussians,
    valid_only,
)


def fit_gaussians(
    scene: Scene,
    config: GaussianConfig,
    *,
    start: Gaussians | None = None,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
    bound: Bound | None = None,
    clock: Clock = time.monotonic,
) -> TrainedGaussians:
    """Learn Gaussians from the training views.

    Nothing depends on the unit of the world: lengths are measured in distances of the cameras.

    Args:
        scene: its `train` split is used, nothing else; every `hold_out`-th view only validates.
        config: numbers, rates, schedule.
        start: Gaussians to begin with; None takes those that `config.start` says.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, changes of the population, saves.
        device: "cpu", or "cuda" with gsplat.
        bound: what the Gaussians hang on, and their start; None trains free ones.
        clock: tells the time to a training that has promised one.

    Raises:
        InputError: no silhouettes for a visual hull, or a bad file of points.
        TrainingError: diverged, no Gaussian was left, or cannot write.
        DependencyError: on a GPU without gsplat.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    where = torch.device(device)
    check_images(scene.split("train"))
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    masked = all(view.has_alpha for view in views)
    if bound is not None:
        start = bound.start
    if start is None:
        generator = torch.Generator().manual_seed(config.seed)
        start = start_gaussians(scene, views, config, generator)
    exposure = ViewExposure(len(views), where) if config.exposure else None
    work = trainable_gaussians(
        start.to(where),
        distance=camera_distance(scene),
        footprint=config.footprint,
        backdrop=config.background,
        seed=config.seed + 1,
        place=None if bound is None else bound.place,
        fits_exposure=exposure is not None,
    )
    pace = _pace(config, scene, clock)
    photos = PhotosInTurn(views)
    ranks = current_ranks()
    shown: list[GaussianPictures] = []

    def losses() -> Losses:
        progress = pace.progress(work.step)
        at_hand = photos.at(reduction_at(config.levels, progress))
        batch = _batch(work, config, len(views))
        found = [picture(index, at_hand[index], color) for index, color in ranks.share(batch)]
        return found[0] if len(batch) == 1 else mean_of(found, of=len(batch))

    def picture(index: int, photo: Photo, color: Tensor) -> Losses:
        found = _drawn(work, config, photo.camera, color.to(where), pace.progress(work.step))
        shown.append(found)
        rgb = found.rgb
        if exposure is not None:
            rgb = exposure.applied(index, rgb, found.alpha, color.to(where))
        target = composite(photo.rgba(), color).to(where).unsqueeze(0)
        rgb = valid_only(rgb, target, photo.valid())
        return picture_losses(rgb, target, config.ssim_weight)

    def after_step(tell: Listener) -> None:
        _observe(work, shown, config.views, ranks)
        shown.clear()
        density = config.density
        due = work.step % density.every == 0 and work.step >= density.first
        progress = pace.progress(work.step)
        if due and progress <= density.last:
            room = density.limit // reduction_at(config.levels, progress)
            most = replace(density, limit=max(config.points, room))
            _change_population(work, most, masked, tell)

    return run_loop(
        work,
        Plan.of(config, validation, scene.name, pace=pace, exposure=exposure),
        losses,
        after_step=after_step,
        folder=folder,
        listener=listener,
    )


def _batch(
    work: TrainableGaussians, config: GaussianConfig, views: int
) -> list[tuple[int, Tensor]]:
    """Views of the coming step and colours behind them.

    All processes draw all of them, so that they go on drawing alike.
    """
    numbers = range(config.views * work.step, config.views * (work.step + 1))
    return [
        (_turn(number, views, config.seed), background_color(config.background, work.generator))
        for number in numbers
    ]


def _drawn(
    work: TrainableGaussians,
    config: GaussianConfig,
    camera: Camera,
    background: Tensor,
    progress: float,
) -> GaussianPictures:
    """A picture that remembers how its centres are pulled, as long as the population changes."""
    viewmat, intrinsics = view_matrices([camera], work.raw["means"])
    found = render_views(
        PosedGaussians(gaussians=work.gaussians(_degree(progress, config))),
        viewmat,
        intrinsics,
        (camera.width, camera.height),
        footprint=config.footprint,
        depth=False,
        background=background,
    )
    if progress <= config.density.last:
        found.means2d.retain_grad()
    return found


def _turn(step: int, views: int, seed: int) -> int:
    """Which view a step sees: all of them once, then all again in another order."""
    # From the step alone, so that a run that goes on needs no list of what is left.
    generator = torch.Generator().manual_seed(seed + 2 + step // views)
    return int(torch.randperm(views, generator=generator)[step % views])


def _pace(config: GaussianConfig, scene: Scene, clock: Clock) -> Pace:
    camera = scene.split("train")[0].camera
    speed = Speed()
    legs = [
        Leg(
            end=level.until,
            cost=speed.seconds(
                camera.width * camera.height / level.reduction**2,
                max(config.points, config.density.limit // level.reduction),
            ),
        )
        for level in (*(config.levels or ()), Level(until=1.0, reduction=1))
    ]
    return Pace(
        config.steps,
        validate_every=config.validate_every,
        save_every=config.save_every,
        seconds=config.seconds,
        legs=legs,
        clock=clock,
    )


def _degree(progress: float, config: GaussianConfig) -> int:
    return min(config.degree, int(progress / config.degree_every))


@torch.no_grad()
def _observe(
    work: TrainableGaussians, shown: Sequence[GaussianPictures], views: int, ranks: Ranks
) -> None:
    """Sum up how strongly the centres are pulled on the screen, per half a picture."""
    if not shown[0].means2d.retains_grad:
        return
    slopes, seen = torch.zeros_like(work.slopes), torch.zeros_like(work.seen)
    for one in shown:
        gradient = one.means2d.grad
        assert gradient is not None
        height, width = one.alpha.shape[1:]
        # Of the loss of this picture alone: the step's is the mean over all of them.
        half = views * gradient.new_tensor([width / 2, height / 2])
        lengths = (gradient * half).norm(dim=-1)
        slopes += lengths.sum(dim=0)
        seen += (lengths > 0).sum(dim=0)
    ranks.add([slopes, seen])
    work.slopes += slopes
    work.seen += seen


@torch.no_grad()
def _change_population(
    work: TrainableGaussians, config: DensityConfig, masked: bool, tell: Listener
) -> None:
    before = work.points
    change = changes(
        work.weights(),
        work.slopes / work.seen.clamp_min(1),
        config,
        work.distance,
        masked=masked,
        generator=work.generator,
    )
    kept, added = int(change.keep.sum()), len(change.new["means"])
    if kept + added == 0:
        raise TrainingError(
            f"training of Gaussians: none is left at step {work.step}, all have become "
            "transparent; check the poses and masks, or lower the learning rates"
        )
    work.replace(change.keep, change.new)
    tell(
        PopulationReport(
            stage=work.stage,
            step=work.step,
            pruned=before - kept,
            grown=added,
            points=work.points,
        )
    )

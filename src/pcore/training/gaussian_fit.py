"""Training of Gaussians on the photos of one scene (Kerbl et al. 2023)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from pcore.data.images import background_color, composite
from pcore.data.scene import Scene, View, check_images, hold_out
from pcore.files.run_folder import RunFolder
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import view_matrices
from pcore.gaussians.render import GaussianPictures, PosedGaussians, render_views
from pcore.geometry.camera import Camera
from pcore.training.events import Listener, silent
from pcore.training.exposure import ViewExposure
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_density import change_population, observe
from pcore.training.gaussian_start import camera_distance, start_gaussians
from pcore.training.loop import run_loop
from pcore.training.loop_plan import Plan
from pcore.training.losses import Losses, mean_of
from pcore.training.near_origin import moved_gaussians, near_origin
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
        scene: its `train` split is used, nothing else; every `hold_out`-th view only validates
            until `held_out_until`.
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
    fit = _fit(scene, config, torch.device(device), start, bound, clock)
    plan = Plan.of(
        config,
        fit.validation,
        scene.name,
        pace=fit.pace,
        exposure=fit.exposure,
        validate_until=_held_out_until(config),
    )
    return run_loop(
        fit.work,
        plan,
        fit.losses,
        after_step=fit.after_step,
        folder=folder,
        listener=listener,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """What a step needs.

    Attributes:
        work: what is trained.
        config: numbers, rates, schedule.
        photos: of the training views, as large as the step wants them; held-out ones last.
        views: how many of them are not held out.
        validation: views that are held out at first.
        masked: whether masks say how large the object is.
        pace: how far the training is.
        exposure: learned along; None takes photos as they are.
        where: the device.
        ranks: processes that train together.
        shown: pictures of the step, until it is done.
    """

    work: TrainableGaussians
    config: GaussianConfig
    photos: PhotosInTurn
    views: int
    validation: Sequence[View]
    masked: bool
    pace: Pace
    exposure: ViewExposure | None
    where: torch.device
    ranks: Ranks
    shown: list[GaussianPictures] = field(default_factory=list[GaussianPictures])

    def losses(self) -> Losses:
        """Draw the photos of the coming step and compare."""
        progress = self.pace.progress(self.work.step)
        at_hand = self.photos.at(reduction_at(self.config.levels, progress))
        held_out = progress < _held_out_until(self.config)
        views = self.views if held_out else self.views + len(self.validation)
        batch = _batch(self.work, self.config, views)
        shared = self.ranks.share(batch)
        found = [self._of_photo(index, at_hand[index], color) for index, color in shared]
        return found[0] if len(batch) == 1 else mean_of(found, of=len(batch))

    def _of_photo(self, index: int, photo: Photo, color: Tensor) -> Losses:
        progress, behind = self.pace.progress(self.work.step), color.to(self.where)
        found = _drawn(self.work, self.config, photo.camera, behind, progress)
        self.shown.append(found)
        rgb = found.rgb
        if self.exposure is not None:
            rgb = self.exposure.applied(index, rgb, found.alpha, behind)
        target = composite(photo.rgba(), color).to(self.where).unsqueeze(0)
        rgb = valid_only(rgb, target, photo.valid())
        return picture_losses(rgb, target, self.config.ssim_weight)

    def after_step(self, tell: Listener) -> None:
        """Let Gaussians come and go where that is due."""
        work, density = self.work, self.config.density
        observe(work, self.shown, self.config.views, self.ranks)
        self.shown.clear()
        due = work.step % density.every == 0 and work.step >= density.first
        progress = self.pace.progress(work.step)
        if due and progress <= density.last:
            room = density.limit // reduction_at(self.config.levels, progress)
            most = replace(density, limit=max(self.config.points, room))
            change_population(work, most, self.masked, tell)


def _fit(
    scene: Scene,
    config: GaussianConfig,
    where: torch.device,
    start: Gaussians | None,
    bound: Bound | None,
    clock: Clock,
) -> _Fit:
    """Make everything ready for the first step; arguments are those of `fit_gaussians`."""
    # What Gaussians hang on is in the world.
    scene, origin = near_origin(scene) if bound is None else (scene, None)
    check_images(scene.split("train"))
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    if bound is not None:
        start = bound.start
    elif start is None:
        generator = torch.Generator().manual_seed(config.seed)
        start = start_gaussians(scene, views, config, generator, origin)
    elif origin is not None:
        start = moved_gaussians(start, -origin)
    photos = (*views, *validation)
    exposure = ViewExposure(len(photos), where) if config.exposure else None
    work = trainable_gaussians(
        start.to(where),
        distance=camera_distance(scene),
        footprint=config.footprint,
        backdrop=config.background,
        seed=config.seed + 1,
        place=None if bound is None else bound.place,
        cameras=[view.camera for view in photos],
        fits_exposure=exposure is not None,
        origin=origin,
    )
    return _Fit(
        work=work,
        config=config,
        photos=PhotosInTurn(photos),
        views=len(views),
        validation=validation,
        masked=all(view.has_alpha for view in views),
        pace=_pace(config, scene, clock),
        exposure=exposure,
        where=where,
        ranks=current_ranks(),
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
    return Pace.of(config, seconds=config.seconds, legs=legs, clock=clock)


def _held_out_until(config: GaussianConfig) -> float:
    return 1.0 if config.held_out_until is None else config.held_out_until


def _degree(progress: float, config: GaussianConfig) -> int:
    return min(config.degree, int(progress / config.degree_every))

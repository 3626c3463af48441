"""Training of Gaussians on the photos of one scene (Kerbl et al. 2023)."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.data.images import background_color
from pcore.data.scene import Scene, check_images, hold_out
from pcore.errors import TrainingError
from pcore.files.run_folder import RunFolder
from pcore.gaussians.render import GaussianPictures, PosedGaussians, render_views, view_matrices
from pcore.training.events import Listener, PopulationReport, silent
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_density import changes
from pcore.training.gaussian_start import camera_distance, start_gaussians
from pcore.training.loop import Plan, run_loop
from pcore.training.losses import Losses
from pcore.training.ssim import ssim
from pcore.training.trainable_gaussians import (
    TrainableGaussians,
    TrainedGaussians,
    photo_on,
    trainable_gaussians,
)


def fit_gaussians(
    scene: Scene,
    config: GaussianConfig,
    *,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
) -> TrainedGaussians:
    """Learn Gaussians from the training views.

    Nothing depends on the unit of the world: lengths are measured in distances of the cameras.

    Args:
        scene: its `train` split is used, nothing else; every `hold_out`-th view only validates.
        config: numbers, rates, schedule.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, changes of the population, saves.
        device: "cpu", or "cuda" with gsplat.

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
    start = start_gaussians(scene, views, config, torch.Generator().manual_seed(config.seed))
    work = trainable_gaussians(
        start.to(where),
        distance=camera_distance(scene),
        footprint=config.footprint,
        backdrop=config.background,
        seed=config.seed + 1,
    )
    matrices = [
        (*view_matrices([view.camera], work.raw["means"]), (view.camera.width, view.camera.height))
        for view in views
    ]
    shown: list[GaussianPictures] = []

    def losses() -> Losses:
        index = _turn(work.step, len(views), config.seed)
        color = background_color(config.background, work.generator)
        viewmat, intrinsics, size = matrices[index]
        found = render_views(
            PosedGaussians(gaussians=work.gaussians(_degree(work.step, config))),
            viewmat,
            intrinsics,
            size,
            footprint=config.footprint,
            background=color.to(where),
        )
        if _grows(work.step, config):
            found.means2d.retain_grad()
        shown[:] = [found]
        photo = photo_on(views[index], color, where)
        valid = views[index].valid()
        if valid is None:
            return _photometric(found.rgb, photo, config.ssim_weight)
        # Where the photo shows nothing, rendering is neither right nor wrong.
        rgb = torch.where(valid.to(where)[..., None], found.rgb, photo)
        return _photometric(rgb, photo, config.ssim_weight)

    def after_step(tell: Listener) -> None:
        _observe(work, shown.pop())
        density = config.density
        due = work.step % density.every == 0 and work.step >= density.first
        if due and _grows(work.step, config):
            _change_population(work, config, masked, tell)

    return run_loop(
        work,
        Plan(
            steps=config.steps,
            rates=config.rates.named(),
            validate_every=config.validate_every,
            save_every=config.save_every,
            validation=validation,
            background=config.background,
            scene=scene.name,
        ),
        losses,
        after_step=after_step,
        folder=folder,
        listener=listener,
    )


def _turn(step: int, views: int, seed: int) -> int:
    """Which view a step sees: all of them once, then all again in another order."""
    # From the step alone, so that a run that goes on needs no list of what is left.
    generator = torch.Generator().manual_seed(seed + 2 + step // views)
    return int(torch.randperm(views, generator=generator)[step % views])


def _degree(step: int, config: GaussianConfig) -> int:
    return min(config.degree, int(step / (config.degree_every * config.steps)))


def _grows(step: int, config: GaussianConfig) -> bool:
    return step <= config.density.last * config.steps


def _photometric(rgb: Tensor, photo: Tensor, ssim_weight: float) -> Losses:
    """(1 - w) L1 + w (1 - SSIM)."""
    error = rgb - photo
    terms = {"l1": (1 - ssim_weight) * error.abs().mean()}
    if ssim_weight > 0:
        terms["ssim"] = ssim_weight * (1 - ssim(rgb, photo))
    return Losses(terms=terms, squared_error=error.detach().square().mean())


@torch.no_grad()
def _observe(work: TrainableGaussians, shown: GaussianPictures) -> None:
    """Sum up how strongly the centres are pulled on the screen, per half a picture."""
    if not shown.means2d.retains_grad:
        return
    gradient = shown.means2d.grad
    assert gradient is not None
    height, width = shown.alpha.shape[1:]
    half = gradient.new_tensor([width / 2, height / 2])
    lengths = (gradient * half).norm(dim=-1)
    work.slopes += lengths.sum(dim=0)
    work.seen += (lengths > 0).sum(dim=0)


@torch.no_grad()
def _change_population(
    work: TrainableGaussians, config: GaussianConfig, masked: bool, tell: Listener
) -> None:
    before = work.points
    change = changes(
        work.weights(),
        work.slopes / work.seen.clamp_min(1),
        config.density,
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

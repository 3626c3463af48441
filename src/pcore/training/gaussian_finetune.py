"""P-CORE on Gaussians: fine-tune them so that what they show commutes with deformation."""

from __future__ import annotations

import torch

from pcore.data.scene import Scene, check_images, hold_out
from pcore.files.run_folder import RunFolder
from pcore.training.budget import Budget
from pcore.training.events import Listener, silent
from pcore.training.gaussian_config import GaussianFinetuneConfig
from pcore.training.gaussian_consistency import GaussianObjective
from pcore.training.gaussian_start import camera_distance
from pcore.training.held_out import scores_by_view
from pcore.training.loop import run_loop
from pcore.training.loop_plan import Plan
from pcore.training.near_origin import moved_gaussians, near_origin
from pcore.training.trainable_gaussians import TrainedGaussians, trainable_gaussians

_LOGIT = 1e-6
"""Opacities of 0 and 1, which files of other trainers hold, have no finite logit."""


def finetune_gaussians(
    scene: Scene,
    base: TrainedGaussians,
    config: GaussianFinetuneConfig,
    *,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
) -> TrainedGaussians:
    """Fine-tune Gaussians with random deformations; no image of a deformed state is used.

    Their number stays.

    Args:
        scene: the one they were trained on; only training views are used.
        base: the pre-trained Gaussians; left as they are.
        config: losses, modes, schedule.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: "cpu", or "cuda" with gsplat.

    Raises:
        TrainingError: diverged, or cannot write.
        DependencyError: on a GPU without gsplat.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    scene, origin = near_origin(scene)
    gaussians = base.gaussians if origin is None else moved_gaussians(base.gaussians, -origin)
    check_images(scene.split("train"))
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    start = gaussians.detached().to(torch.device(device))
    inside = start.opacities.clamp(_LOGIT, 1 - _LOGIT)
    work = trainable_gaussians(
        start.each(lambda one: inside if one is start.opacities else one),
        distance=camera_distance(scene),
        footprint=base.footprint,
        backdrop=config.background,
        seed=config.seed,
        stage="finetune",
        origin=origin,
    )
    budget = None
    if config.largest_loss is not None and validation:
        budget = Budget(
            before={name: tensor.clone() for name, tensor in work.weights().items()},
            psnr=[one["psnr"] for one in scores_by_view(work, validation, config.background)],
            largest_loss=config.largest_loss,
        )
    return run_loop(
        work,
        Plan.of(config, validation, scene.name),
        GaussianObjective(config, work, start, views),
        budget=budget,
        folder=folder,
        listener=listener,
    )

"""P-CORE: fine-tune the attention so that its surface commutes with deformation."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial

import torch

from pcore.contrib.learned_skinning import Skinning
from pcore.data.scene import Scene, View, check_images, hold_out
from pcore.files.run_folder import RunFolder
from pcore.training.budget import Budget
from pcore.training.compiling import compile_networks
from pcore.training.config import FinetuneConfig
from pcore.training.events import Listener, silent
from pcore.training.held_out import validate
from pcore.training.loop import run_loop
from pcore.training.loop_plan import Plan
from pcore.training.losses import perceptual_loss
from pcore.training.near_origin import moved_trained, near_origin
from pcore.training.objective import Objective
from pcore.training.random_motion import skinning_to_train
from pcore.training.trainable import Trainable, trainable
from pcore.training.trained import Trained


def finetune(
    scene: Scene,
    base: Trained,
    config: FinetuneConfig,
    *,
    folder: RunFolder | None = None,
    listener: Listener = silent,
    device: str = "cpu",
    compiled: bool = True,
) -> Trained:
    """Fine-tune a pre-trained model with random deformations; no image of a deformed state is used.

    Args:
        scene: the one it was trained on; only training views are used.
        base: the pre-trained model; left as it is.
        config: losses, modes, schedule, and whether a skinning learns along.
        folder: where to save and what to continue from; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: "cpu", "cuda", ...
        compiled: use torch.compile where it pays, on a GPU.

    Returns:
        The tuned model, with its skinning where one was trained.

    Raises:
        InputError: fewer points than the skinning wants anchors.
        WeightsError: LPIPS was asked for and its weights are missing.
        TrainingError: diverged, cannot be compiled or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    where = torch.device(device)
    scene, origin = near_origin(scene)
    base = base if origin is None else moved_trained(base, -origin)
    views, validation = hold_out(scene.split("train"), every=config.hold_out)
    perceptual = perceptual_loss(config.lpips_weight, config.lpips_trunk, where)
    check_images(scene.split("train"))
    anchor = _moved(base, where)
    work = _work(anchor, config)
    work.origin = origin
    if compiled:
        compile_networks(where, work.papr.unet, perceptual)
    objective = Objective(config, work, anchor, perceptual)
    rates = {} if config.skinning is None else {"skinning": config.skinning.rate}
    return run_loop(
        work,
        Plan.of(config, validation, scene.name, rates=rates),
        partial(objective.of_step, views),
        budget=_budget(anchor, work, validation, config),
        finish=lambda tell: work.complete(scene.split("train"), tell),
        folder=folder,
        listener=listener,
    )


def _moved(base: Trained, device: torch.device) -> Trained:
    return Trained(
        papr=copy.deepcopy(base.papr).to(device).requires_grad_(False).eval(),
        cloud=base.cloud.detached().to(device),
        step=base.step,
    )


def _work(anchor: Trained, config: FinetuneConfig) -> Trainable:
    skinning: Skinning | None = None
    if config.skinning is not None:
        skinning = skinning_to_train(anchor.cloud, config.skinning, seed=config.seed)
    return trainable(
        "finetune",
        copy.deepcopy(anchor.papr).train(),
        anchor.cloud,
        seed=config.seed,
        train_points=False,
        skinning=skinning,
    )


def _budget(
    anchor: Trained, work: Trainable, validation: Sequence[View], config: FinetuneConfig
) -> Budget | None:
    """Return what the result may cost; None where nothing limits or measures that."""
    if config.largest_loss is None or not validation:
        return None
    return Budget(
        before={name: t.clone() for name, t in work.weights().items()},
        psnr=[validate(anchor, [view], config.background)["psnr"] for view in validation],
        largest_loss=config.largest_loss,
    )

"""Train and fine-tune assets of Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.run_options import RunOptions
from pcore.asset.saving import load
from pcore.data.scene import Scene
from pcore.files.provenance import Provenance
from pcore.files.records import to_dict
from pcore.files.run_folder import RunFolder, bytes_needed
from pcore.files.run_record import RunRecord, of_scene
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.training.events import Listener
from pcore.training.gaussian_config import GaussianConfig, GaussianFinetuneConfig
from pcore.training.gaussian_finetune import finetune_gaussians
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.in_folder import FolderPlan, train_in_folder
from pcore.training.trainable_gaussians import TrainedGaussians, provenance_of_gaussians

_NUMBERS = 11
"""Of a Gaussian besides its harmonics."""


def gaussian_plan(
    scene: Scene,
    config: GaussianConfig,
    folder: Path | str | None,
    *,
    preset: str | None,
    resume: bool,
    tensorboard: bool,
    note: Callable[[str], None],
) -> FolderPlan:
    """What a training of Gaussians in a folder is, beside the training itself."""
    most = max(config.points, config.density.limit)
    return FolderPlan(
        path=Path(folder or ""),
        stage="pretrain",
        scene=scene.name if scene.folder is None else scene.folder.resolve(),
        config={
            "model": "gaussians",
            "preset": preset,
            **of_scene(scene, None if folder is None else Path(folder)),
            "gaussians": to_dict(config),
        },
        resume=resume,
        tensorboard=tensorboard,
        needed=bytes_needed((_NUMBERS + 3 * (config.degree + 1) ** 2) * most),
        note=note,
    )


def train_gaussians(
    scene: Scene,
    config: GaussianConfig,
    plan: FolderPlan,
    listener: Listener,
    device: str,
    *,
    keep: bool,
) -> tuple[Asset, bool]:
    """Learn Gaussians from the training views of a scene.

    Args:
        scene: its `train` split is used, nothing else.
        config: numbers, rates, schedule.
        plan: the run folder and its record.
        listener: told of all events.
        device: where to train, and then to draw.
        keep: write the folder; else everything stays in memory.

    Returns:
        The object, and whether anything was learned: a finished run is left as it is.

    Raises:
        InputError: the folder is in use, or no silhouettes for a visual hull.
        TrainingError: diverged, or cannot write.
        DependencyError: on a GPU without gsplat.
        KeyboardInterrupt: Ctrl-C, after saving.
    """

    def run(folder: RunFolder | None, tell: Listener) -> TrainedGaussians:
        return fit_gaussians(scene, config, folder=folder, listener=tell, device=device)

    return _made(scene, plan, run, listener, device, keep=keep)


def tune_gaussians(
    asset: Asset,
    scene: Scene,
    config: GaussianFinetuneConfig,
    folder: Path | None,
    listener: Listener,
    device: str,
    *,
    about: Mapping[str, Any],
    options: RunOptions,
) -> tuple[Asset, bool]:
    """Fine-tune Gaussians with random deformations; result and errors as of `train_gaussians`.

    Args:
        asset: the object it begins with; left as it is.
        scene: the one that it was trained on.
        config: losses, schedule.
        folder: of the run; None keeps everything in memory.
        listener: told of all events.
        device: where to train, and then to draw.
        about: what the record says besides the settings.
        options: resuming, logs.
    """
    content = asset.content
    assert isinstance(content, GaussianContent), "the caller tells objects apart"
    base = TrainedGaussians(
        gaussians=content.gaussians,
        footprint=content.footprint,
        background=content.background,
        step=asset.provenance.step,
    )
    plan = FolderPlan(
        path=folder or Path(),
        stage="finetune",
        scene=scene.name if scene.folder is None else scene.folder.resolve(),
        config={"model": "gaussians", **about, "finetune": to_dict(config)},
        resume=options.resume,
        tensorboard=options.tensorboard,
        needed=bytes_needed((_NUMBERS + base.gaussians.sh[0].numel()) * len(base.gaussians)),
        note=options.note,
    )

    def run(out: RunFolder | None, tell: Listener) -> TrainedGaussians:
        return finetune_gaussians(scene, base, config, folder=out, listener=tell, device=device)

    return _made(scene, plan, run, listener, device, keep=folder is not None)


def keep_light(asset: Asset, content: GaussianContent) -> Asset:
    """Give an object content with normals and a light, and write both where it has a folder.

    Raises:
        OSError: a file cannot be written.
    """
    if asset.record.path is not None:
        content.save_gaussians(asset.path, asset.provenance)
        if content.light is not None:
            save_light(asset.path / LIGHT_FILE, content.light)
    return replace(asset, content=content)


def _made(
    scene: Scene,
    plan: FolderPlan,
    run: Callable[[RunFolder | None, Listener], TrainedGaussians],
    listener: Listener,
    device: str,
    *,
    keep: bool,
) -> tuple[Asset, bool]:
    """Train as planned, in the folder or in memory."""
    if not keep:
        found = run(None, listener)
        record = RunRecord(stage=plan.stage, scene=str(plan.scene), config=plan.config)
        return _asset(found, provenance_of_gaussians(found, scene.name), record, device), True
    learned = train_in_folder(plan, run, listener)
    return load(plan.path, device=device), learned is not None


def _asset(
    found: TrainedGaussians, provenance: Provenance, record: RunRecord, device: str
) -> Asset:
    content = GaussianContent(
        gaussians=found.gaussians.to(device),
        footprint=found.footprint,
        background=found.background,
    )
    return Asset(content=content, provenance=provenance, record=record)

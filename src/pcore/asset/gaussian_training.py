"""Train an asset of Gaussians; what `pcore train --model gaussians` does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import load
from pcore.data.scene import Scene
from pcore.files.provenance import Provenance
from pcore.files.records import to_dict
from pcore.files.run_folder import bytes_needed
from pcore.files.run_record import RunRecord, of_scene
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.training.events import Listener
from pcore.training.gaussian_config import GaussianConfig
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
    if not keep:
        found = fit_gaussians(scene, config, listener=listener, device=device)
        record = RunRecord(stage="pretrain", scene=str(plan.scene), config=plan.config)
        return _asset(found, provenance_of_gaussians(found, scene.name), record, device), True
    learned = train_in_folder(
        plan,
        lambda run, tell: fit_gaussians(scene, config, folder=run, listener=tell, device=device),
        listener,
    )
    return load(plan.path, device=device), learned is not None


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


def _asset(
    found: TrainedGaussians, provenance: Provenance, record: RunRecord, device: str
) -> Asset:
    content = GaussianContent(
        gaussians=found.gaussians.to(device),
        footprint=found.footprint,
        background=found.background,
    )
    return Asset(content=content, provenance=provenance, record=record)

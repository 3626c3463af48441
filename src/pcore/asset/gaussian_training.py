"""Train an asset of Gaussians; what `pcore train --model gaussians` does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import load
from pcore.data.scene import Scene
from pcore.files.provenance import Provenance
from pcore.files.records import to_dict
from pcore.files.run_folder import bytes_needed
from pcore.files.run_record import RunRecord
from pcore.training.events import Listener
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.in_folder import FolderPlan, train_in_folder
from pcore.training.trainable_gaussians import TrainedGaussians, provenance_of_gaussians

_NUMBERS = 11
"""Of a Gaussian besides its harmonics."""


def train_gaussians(
    scene: Scene,
    config: GaussianConfig,
    folder: Path | None,
    listener: Listener,
    device: str,
    plan: FolderPlan,
) -> Asset:
    """Learn Gaussians from the training views of a scene.

    Args:
        scene: its `train` split is used, nothing else.
        config: numbers, rates, schedule.
        folder: for the run; None keeps everything in memory.
        listener: told of all events.
        device: where to train, and then to draw.
        plan: the run folder, but for what is written down about it; see `FolderPlan`.

    Raises:
        InputError: the folder is in use, or no silhouettes for a visual hull.
        TrainingError: diverged, or cannot write.
        DependencyError: on a GPU without gsplat.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    if folder is None:
        found = fit_gaussians(scene, config, listener=listener, device=device)
        record = RunRecord(stage="pretrain", scene=str(plan.scene), config=plan.config)
        return _asset(found, provenance_of_gaussians(found, scene.name), record, device)
    numbers = _NUMBERS + 3 * (config.degree + 1) ** 2
    most = max(config.points, config.density.limit)
    train_in_folder(
        replace(plan, needed=bytes_needed(numbers * most)),
        lambda run, tell: fit_gaussians(scene, config, folder=run, listener=tell, device=device),
        listener,
    )
    return load(folder, device=device)


def gaussian_record(config: GaussianConfig, preset: str | None, factor: int) -> dict[str, object]:
    """All that decides the result, as JSON values."""
    return {
        "model": "gaussians",
        "preset": preset,
        "factor": factor,
        "gaussians": to_dict(config),
    }


def _asset(
    found: TrainedGaussians, provenance: Provenance, record: RunRecord, device: str
) -> Asset:
    content = GaussianContent(
        gaussians=found.gaussians.to(device),
        footprint=found.footprint,
        background=found.background,
    )
    return Asset(content=content, provenance=provenance, record=record)

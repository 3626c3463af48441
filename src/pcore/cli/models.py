"""Runs as the evaluating verbs read them: the model, its scene, and what it was tuned from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from pcore.cli.runtime import recorded_factor
from pcore.data.scene import Scene
from pcore.errors import CheckpointError
from pcore.files.model_file import SavedModel, load_model
from pcore.files.run_folder import RunFolder
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.visibility import seen_by
from pcore.model.papr import Papr
from pcore.training.config import FinetuneConfig, PresetName

_WHITE = (1.0, 1.0, 1.0)
UNTUNED = "PAPR"
_NAMES = {"finetune": "P-CORE"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A run folder, opened for reading.

    Attributes:
        path: the folder.
        papr: the networks, rendering on white as the metrics do.
        cloud: canonical points, world units.
        label: what made it: `PAPR`, or `P-CORE` after fine-tuning.
        manifest: what `run.json` says.
        saved: the model as it is in the file, with its own background.
    """

    path: Path
    papr: Papr
    cloud: PointCloud
    label: str
    manifest: RunFolder
    saved: SavedModel

    @property
    def factor(self) -> int:
        """Down-scaling factor that its training images had; 1 when none is on record."""
        return recorded_factor(self.manifest)

    @property
    def base(self) -> Path | None:
        """Folder of the run that this one was fine-tuned from; None for other runs."""
        found = self.manifest.config.get("base")
        return None if found is None else self.path / str(found)


def open_run(path: Path, *, device: str = "cpu") -> Run:
    """Open a run folder.

    Raises:
        CheckpointError: there is no run, or its model is missing or damaged.
    """
    manifest = RunFolder.open(path)
    saved = load_model(path)
    # The true images lie on white; the background only enters after the networks.
    papr = Papr(replace(saved.config, background=_WHITE))
    papr.load_state_dict(saved.papr_state)
    return Run(
        path=path,
        papr=papr.eval().requires_grad_(False).to(device),
        cloud=saved.cloud,
        label=_NAMES.get(saved.provenance.stage, UNTUNED),
        manifest=manifest,
        saved=saved,
    )


def baseline_of(run: Run, given: Path | None, *, device: str = "cpu") -> Run | None:
    """Open the run to compare with: the one given, else the one that `run` was tuned from.

    Raises:
        CheckpointError: it is not there or damaged.
    """
    if given is not None:
        return open_run(given, device=device)
    if run.base is None:
        return None
    try:
        return open_run(run.base, device=device)
    except CheckpointError as error:
        raise CheckpointError(
            f"{run.path} was fine-tuned from {run.base}, which cannot be read: {error}; give that "
            "run with --baseline"
        ) from error


def never_seen(cloud: PointCloud, scene: Scene) -> Tensor:
    """(N,) bool, which canonical points no training view saw.

    Raises:
        SceneError: the training split is damaged.
    """
    return ~seen_by(cloud.positions, [view.camera for view in scene.split("train")])


def finetune_config(
    run: RunFolder, model: SavedModel, preset: PresetName | None = None
) -> tuple[PresetName, FinetuneConfig]:
    """Name and settings of P-CORE for a pre-trained run.

    Args:
        run: says which preset it was trained with; its background stays.
        model: the run's.
        preset: name of another preset.
    """
    from pcore.training.presets import finetune_preset

    known: dict[Any, PresetName] = {"tiny": "tiny", "fast": "fast"}
    name = preset or known.get(str(run.config.get("preset")), "paper")
    black = model.config.background == (0.0, 0.0, 0.0)
    return name, replace(finetune_preset(name), background="black" if black else "white")

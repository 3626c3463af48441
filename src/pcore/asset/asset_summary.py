"""What a run folder or model file says about itself, read without its networks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pcore.asset.saving import load
from pcore.errors import CheckpointError
from pcore.files.gaussian_file import GAUSSIANS_FILE, GaussianSummary, describe_gaussians
from pcore.files.headers import name_in_folder
from pcore.files.model_file import MODEL_FILE, ModelSummary, describe_model
from pcore.files.run_record import RunRecord
from pcore.files.skinning_file import SKINNING_FILE, SkinningSummary, describe_skinning
from pcore.files.training_state import STATE_FILE, load_state
from pcore.relight.description import describe_light
from pcore.relight.light_file import LIGHT_FILE


@dataclass(frozen=True, kw_only=True)
class AssetSummary:
    """What is known of an object, perhaps before its training has saved a model.

    Attributes:
        record: how it came to be; None for a bare model file.
        saved_step: that a training can go on from; None where no state is saved.
        model_file: where its model is or will be.
        model: sizes and origin of the model; None where none is saved yet, and for Gaussians.
        gaussians: sizes and origin of an object made of them; None for others.
        skinning: of learned weights; None where none were learned.
        light: in a sentence, or why it cannot be used; None where none was estimated.
    """

    record: RunRecord | None
    saved_step: int | None
    model_file: Path
    model: ModelSummary | None
    gaussians: GaussianSummary | None = None
    skinning: SkinningSummary | None = None
    light: str | None = None


def summarize(path: Path | str) -> AssetSummary:
    """Say what lies in a run folder, finished or not, or in a model file.

    Args:
        path: of either.

    Raises:
        CheckpointError: there is neither, or what is there is damaged.
    """
    path = Path(path)
    if not path.is_dir():
        drawn = path.is_file() and name_in_folder(path) == GAUSSIANS_FILE
        return AssetSummary(
            record=None,
            saved_step=None,
            model_file=path,
            model=None if drawn else describe_model(path),
            gaussians=describe_gaussians(path) if drawn else None,
        )
    record, state, model = RunRecord.read(path), path / STATE_FILE, path / MODEL_FILE
    weights, made = path / SKINNING_FILE, path / GAUSSIANS_FILE
    return AssetSummary(
        record=record,
        saved_step=load_state(state).step if state.exists() else None,
        model_file=made if made.exists() else model,
        model=describe_model(model) if model.exists() else None,
        gaussians=describe_gaussians(made) if made.exists() else None,
        skinning=describe_skinning(weights) if weights.exists() else None,
        light=_light_of(path) if model.exists() or made.exists() else None,
    )


def _light_of(folder: Path) -> str | None:
    if not (folder / LIGHT_FILE).is_file():
        return None
    try:
        asset = load(folder)
        light, surfels = asset.light, asset.content.surfels
    except CheckpointError as error:
        return f"cannot be used: {error}"
    if light is None or surfels is None:
        return None
    return describe_light(light, surfels)

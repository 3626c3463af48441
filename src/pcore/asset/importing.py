"""Assets of checkpoints that other programs made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pcore.asset.asset import Asset
from pcore.asset.saving import load
from pcore.files.official import load_official
from pcore.files.provenance import provenance_of
from pcore.files.records import to_dict
from pcore.files.run_folder import RunFolder, bytes_needed
from pcore.model.papr_config import ReferenceOrigin


def import_papr(
    model: Path,
    settings: Sequence[Path],
    folder: Path | str,
    *,
    reference: ReferenceOrigin | None = None,
) -> Asset:
    """Make an asset of a checkpoint of the original PAPR; nothing in the file is executed.

        asset = pcore.import_papr(Path("model.pth"), [Path("lego.yml")], "runs/lego")

    Args:
        model: the original's model.pth.
        settings: its YAML configuration; of several files the later ones win.
        folder: new or empty folder for the run.
        reference: let all rays begin at this distance before its center; None begins them at the
            camera, as the original does.

    Raises:
        CheckpointError: a file is missing, damaged, or of a model that is not supported.
        InputError: the folder is in use.
        TrainingError: it cannot be written.
    """
    official = load_official(model, settings)
    config = replace(official.config, reference=reference)
    scene, step = str(official.provenance["scene"]), int(official.provenance["step"] or 0)
    numbers = sum(value.numel() for value in official.state.values())
    came = provenance_of(official.cloud, config, scene=scene, stage="import", step=step)
    with RunFolder.create(
        Path(folder),
        stage="import",
        scene=scene,
        config={"papr": to_dict(config), "source": official.provenance},
        needed=bytes_needed(numbers + official.cloud.features.numel()),
    ) as run:
        run.save_model(official.state, official.cloud, config, came)
        run.update(status="finished", step=step)
    return load(folder)

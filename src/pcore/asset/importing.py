"""Assets of checkpoints that other programs made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pcore.asset.asset import WHITE, Asset
from pcore.asset.content import Color
from pcore.asset.saving import load
from pcore.files.gaussian_file import SavedGaussians, save_gaussians
from pcore.files.official import load_official
from pcore.files.provenance import provenance_of
from pcore.files.records import to_dict
from pcore.files.run_folder import RunFolder, write_guard
from pcore.files.run_place import bytes_needed
from pcore.files.run_record import relative
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
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
    came = provenance_of(
        official.cloud.positions, config.background, scene=scene, stage="import", step=step
    )
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


def save_imported(
    gaussians: Gaussians,
    footprint: Footprint,
    folder: Path | str,
    *,
    file: Path,
    scene: Path | None = None,
    factor: int = 1,
    background: Color | None = None,
) -> Asset:
    """Make an asset of Gaussians that another program trained.

    Args:
        gaussians: in the world of the cameras, float32 on the CPU.
        footprint: how that program met pixels.
        folder: new or empty folder for the run.
        file: where they come from.
        scene: folder of their photos, which is that of the run; None where they are not known.
        factor: by which the photos are down-scaled.
        background: of their pictures; None is white.

    Raises:
        InputError: the folder is in use.
        TrainingError: it cannot be written.
    """
    name, folder = str(scene or file), Path(folder)
    provenance = provenance_of(
        gaussians.means, background or WHITE, scene=name, stage="import", step=0
    )
    source = {"file": str(file), "footprint": to_dict(footprint)}
    known = {} if scene is None else {"factor": factor}
    with RunFolder.create(
        folder,
        stage="import",
        scene=name if scene is None else relative(scene, folder),
        config={"model": "gaussians", "source": source, **known},
        needed=bytes_needed(sum(tensor.numel() for tensor in vars(gaussians).values())),
    ) as run:
        saved = SavedGaussians(gaussians=gaussians, footprint=footprint, provenance=provenance)
        with write_guard(run.gaussians):
            save_gaussians(run.gaussians, saved)
        run.update(status="finished", step=0)
    return load(folder)

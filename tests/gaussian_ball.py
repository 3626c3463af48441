"""A run of flat Gaussians that cover a ball."""

from pathlib import Path

import torch

from pcore.files.gaussian_file import SavedGaussians, save_gaussians
from pcore.files.provenance import Provenance
from pcore.files.run_folder import RunFolder
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint


def ball_run(path: Path, count: int = 400) -> Path:
    """A run of flat, opaque Gaussians that cover a ball of radius 0.8."""
    turn = torch.arange(count) * 2.399963
    z = 1 - 2 * (torch.arange(count) + 0.5) / count
    normals = torch.stack([(1 - z**2).sqrt() * turn.cos(), (1 - z**2).sqrt() * turn.sin(), z], 1)
    half = torch.nn.functional.normalize(normals + torch.tensor([0.0, 0.0, 1.0]), dim=1)
    quats = torch.cat([torch.zeros(count, 1), half], dim=1)  # Half a turn takes z to the normal.
    sh = torch.zeros(count, 1, 3)
    sh[:, 0] = normals * 1.5
    gaussians = Gaussians(
        means=0.8 * normals,
        quats=quats,
        scales=torch.tensor([0.09, 0.09, 0.004]).expand(count, 3).clone(),
        opacities=torch.full((count,), 0.95),
        sh=sh,
    )
    came = Provenance(
        scene="ball",
        stage="import",
        step=0,
        background=(1.0, 1.0, 1.0),
        extent=((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8)),
        pcore="0",
    )
    saved = SavedGaussians(gaussians=gaussians, footprint=Footprint(), provenance=came)
    with RunFolder.create(path, stage="import", scene="", config={}) as run:
        save_gaussians(path / "gaussians.safetensors", saved)
        run.update(status="finished")
    return path

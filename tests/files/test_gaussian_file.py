"""The file of a run's Gaussians: what is written is read; what is damaged is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from pcore.errors import CheckpointError
from pcore.files.gaussian_file import SavedGaussians, load_gaussians, save_gaussians
from pcore.files.provenance import Provenance
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint

SAVED = SavedGaussians(
    gaussians=Gaussians(
        means=torch.rand(5, 3),
        quats=torch.eye(4)[[0, 1, 2, 3, 0]],
        scales=torch.rand(5, 3) + 0.1,
        opacities=torch.rand(5),
        sh=torch.randn(5, 4, 3),
    ),
    footprint=Footprint(variance=0.2, antialiased=False),
    provenance=Provenance(
        scene="box",
        stage="pretrain",
        step=7,
        background=(1.0, 1.0, 1.0),
        extent=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        pcore="0",
    ),
)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    save_gaussians(tmp_path / "gaussians.safetensors", SAVED)
    found = load_gaussians(tmp_path)
    for name in ("means", "quats", "scales", "opacities", "sh"):
        assert torch.equal(getattr(found.gaussians, name), getattr(SAVED.gaussians, name))
    assert (found.footprint, found.provenance) == (SAVED.footprint, SAVED.provenance)


def test_flat_ones_are_told_from_others_and_from_older_files(tmp_path: Path) -> None:
    path = tmp_path / "gaussians.safetensors"
    flat = Footprint(flat=True, pixel=0.01)
    save_gaussians(path, replace(SAVED, footprint=flat))
    assert load_gaussians(path).footprint == flat
    save_gaussians(path, SAVED)
    # Older files do not say so; spaces keep the length of the header.
    content = path.read_bytes()
    entry = b', \\"flat\\": false, \\"pixel\\": null'
    assert content.count(entry) == 1
    path.write_bytes(content.replace(entry, b" " * len(entry)))
    assert load_gaussians(path).footprint == SAVED.footprint


def test_damage_is_named(tmp_path: Path) -> None:
    path = tmp_path / "gaussians.safetensors"
    with pytest.raises(CheckpointError, match="no gaussians at"):
        load_gaussians(path)
    broken = SAVED.gaussians.each(torch.clone)
    broken.means[1, 1] = torch.nan
    save_gaussians(path, replace(SAVED, gaussians=broken))
    with pytest.raises(CheckpointError, match="finite means"):
        load_gaussians(path)
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(CheckpointError, match="damaged"):
        load_gaussians(path)

"""Bundles for Blender: what is in them, cages that hold everything, and what is refused."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import tyro
from rich.console import Console

from gaussian_ball import ball_run
from pcore.asset import meshing
from pcore.asset.blender_bundle import cage_around
from pcore.asset.saving import load
from pcore.capture.load import load_cameras
from pcore.cli.blender import BlenderExportCommand, export_bundle
from pcore.errors import CheckpointError, InputError

pytest.importorskip("skimage", reason="the extra mesh is not installed")


def command(root: Path, *words: str) -> BlenderExportCommand:
    args = [str(root / "ball"), "-o", str(root / "bundle"), "--resolution", "24", *words]
    return tyro.cli(BlenderExportCommand, args=[*args, "--threads", "1", "--device", "cpu"])


def test_a_bundle_holds_the_object_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(meshing, "_VIEWS", 16)
    ball_run(tmp_path / "ball")
    export_bundle(command(tmp_path, "--fps", "30"), Console(quiet=True))
    bundle, points = tmp_path / "bundle", load(tmp_path / "ball").points
    about = json.loads((bundle / "bundle.json").read_text())
    cloud = trimesh.load(bundle / "points.ply", process=False)
    digest = hashlib.sha256(np.asarray(cloud.vertices).astype("<f4").tobytes()).hexdigest()
    assert (about["points_hash"], about["fps"]) == (digest[:16], 30)
    assert about["axes"] == np.eye(3).tolist()
    assert (bundle / about["run_folder"]).resolve() == (tmp_path / "ball").resolve()
    cage = trimesh.load(bundle / "cage.ply", process=False)
    assert cage.is_watertight
    assert cage.volume > 4.18 * 0.8**3
    proxy = trimesh.load(bundle / "proxy.ply", process=False)
    assert abs(float(np.linalg.norm(proxy.vertices, axis=1).mean()) - 0.8) < 0.05
    near = torch.tensor(json.loads((bundle / "anchors.json").read_text())["near"])
    assert near.shape == (128, 3)
    assert float(torch.cdist(near.double(), points.double()).amin(dim=1).max()) < 1e-6
    assert len(load_cameras(bundle / "cameras.json")) == 24
    with pytest.raises(InputError, match="holds files already"):
        export_bundle(command(tmp_path), Console(quiet=True))


@pytest.mark.parametrize("words", [("--fps", "0"), ("--resolution", "7")])
def test_numbers_that_make_no_bundle_are_refused(tmp_path: Path, words: tuple[str, ...]):
    with pytest.raises(InputError, match="expected at least"):
        export_bundle(command(tmp_path, *words), Console(quiet=True))


def test_no_run_no_bundle(tmp_path: Path):
    with pytest.raises(CheckpointError):
        export_bundle(command(tmp_path), Console(quiet=True))
    assert not (tmp_path / "bundle").exists()


def test_cages_hold_any_cloud():
    random = torch.Generator().manual_seed(3)
    ring = torch.linspace(0, 6.2, 300)
    clouds = {
        "ring": torch.stack([ring.cos(), ring.sin(), 0 * ring], dim=1),
        "hollow": torch.nn.functional.normalize(torch.randn(500, 3, generator=random), dim=1),
        "two far apart": torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [50.0, 0, 0]]),
        "line": torch.linspace(0, 1e-3, 40)[:, None] * torch.tensor([1.0, 2.0, 0.0]),
    }
    for name, points in clouds.items():
        cage = cage_around(points)
        assert bool(cage.holds(points).all()), name
        assert 20 < len(cage.vertices) < 2000, name
    with pytest.raises(InputError, match="all in one place"):
        cage_around(torch.ones(5, 3))

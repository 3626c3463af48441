"""The examples run as they stand there, one after the other, on a tiny scene."""

import re
import runpy
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import tiny_scene
from pcore.editing.script import load_edit
from pcore.files.model_file import describe_model, save_model
from pcore.files.provenance import provenance_of
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
EDIT = '{"version": 2, "edits": [{"type": "scale", "factor": 0.5}]}'
SIZE = 32


@pytest.fixture
def run_example(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Runs an example as a program, in this process; gives what it prints."""

    def run(name: str, *args: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, args)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file that shows a box opaque wherever a point is near a ray."""
    config = replace(tiny_scene.CONFIG, cutoff=0.1, background_score=-3.0)
    torch.manual_seed(0)
    cloud = PointCloud(
        positions=(torch.rand(300, 3) - 0.5) * torch.tensor([1.2, 0.9, 0.7]),
        features=torch.randn(300, config.feature_size),
        influence=torch.ones(300),
    )
    came = provenance_of(cloud.positions, config.background, scene="box", stage="pretrain", step=1)
    path = tmp_path_factory.mktemp("examples") / "model.safetensors"
    save_model(path, Papr(config).state_dict(), cloud, config, came)
    return path


def test_train_with_a_listener(run_example: Callable[..., str], tmp_path: Path) -> None:
    scene = tiny_scene.write_scene(tmp_path / "box", meshes=False, states=False)
    out = run_example("01_train.py", scene, tmp_path / "run", "--steps", 10)
    assert "step 10 of 10: 6000 points, rgb" in out
    assert "dB on 1 held-out views" in out
    provenance = describe_model(tmp_path / "run").provenance
    assert (provenance.scene, provenance.stage, provenance.step) == ("box", "pretrain", 10)


def test_edit_and_render(run_example: Callable[..., str], model: Path, tmp_path: Path) -> None:
    edit = tmp_path / "small.json"
    edit.write_text(EDIT)
    out = run_example("02_edit.py", model, edit, tmp_path / "pictures", "--size", SIZE)
    for name in ("canonical", "canonical_depth", "deformed", "deformed_depth"):
        with Image.open(tmp_path / "pictures" / f"{name}.png") as picture:
            assert picture.size == (SIZE, SIZE)
    canonical, deformed = (float(share) for share in re.findall(r"covers ([\d.]+) %", out))
    # Half as large, seen from the same place.
    assert 0 < deformed < 0.5 * canonical < 50


def test_own_deformation(run_example: Callable[..., str], model: Path, tmp_path: Path) -> None:
    out = run_example("03_own_deformation.py", tmp_path / "wave.png", model, model, "--size", SIZE)
    # A shear changes no volume.
    assert out.count("det J from 1.000 to 1.000") == 2
    with Image.open(tmp_path / "wave.png") as shown:
        pixels = np.asarray(shown)
    assert pixels.shape == (2 * SIZE, 2 * SIZE, 3)
    assert np.array_equal(pixels[:SIZE], pixels[SIZE:])
    assert not np.array_equal(pixels[:, :SIZE], pixels[:, SIZE:])


def test_session(run_example: Callable[..., str], model: Path, tmp_path: Path) -> None:
    edit, picture = tmp_path / "edit.json", tmp_path / "strain.png"
    out = run_example("04_session.py", model, edit, picture, "--size", SIZE)
    kept, still = map(int, re.findall(r"kept (\d+) steps, (\d+) points", out)[0])
    assert kept >= 1
    assert 30 < still < 150  # A quarter of 300.
    assert len(load_edit(edit).edits) == kept
    with Image.open(picture) as shown:
        assert shown.size == (2 * SIZE, SIZE)


def test_examples_are_short() -> None:
    files = sorted(EXAMPLES.glob("[0-9][0-9]_*.py"))
    assert [file.name[:2] for file in files] == ["01", "02", "03", "04"]
    assert all(len(file.read_text().splitlines()) <= 80 for file in files)

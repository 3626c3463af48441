"""Pictures by Blender's Cycles are those of the embedded renderer, but for light between surfaces.

PCORE_BPY names a Python that imports bpy, where this one does not; else the pictures are skipped.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from figure_model import figure
from PIL import Image

from pcore.benchmark import blender_renderer
from pcore.benchmark.blender_renderer import blender, blender_python
from pcore.benchmark.look import Look, Material, Texture
from pcore.cli.main import main
from pcore.errors import DependencyError, InputError

BPY = os.environ.get("PCORE_BPY") or (sys.executable if importlib.util.find_spec("bpy") else None)


def make(folder: Path, *words: str) -> int:
    path = folder / "figure.glb"
    path.write_bytes(figure().content())
    sizes = ["--size", "64", "--train-views", "3", "--test-views", "2", "--no-analytic"]
    return main(["benchmark", "make", str(path), *sizes, *words])


@pytest.mark.bpy
@pytest.mark.timeout(600)
@pytest.mark.skipif(BPY is None, reason="no Blender: set PCORE_BPY to a Python that imports bpy")
def test_cycles_shows_what_the_embedded_renderer_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PCORE_BPY", str(BPY))
    assert make(tmp_path, "-o", str(tmp_path / "one")) == 0
    assert make(tmp_path, "-o", str(tmp_path / "two"), "--renderer", "blender") == 0
    assert json.loads((tmp_path / "two" / "scene.json").read_text())["renderer"] == "blender"
    pictures = sorted((tmp_path / "one").rglob("r_*.png"))
    assert len(pictures) == 3 + 2 + 2
    for path in pictures:
        other = tmp_path / "two" / path.relative_to(tmp_path / "one")
        ours, theirs = (np.asarray(Image.open(p)).astype(float) for p in (path, other))
        # Sixteen places of a pixel against 32 random ones.
        assert np.abs(ours - theirs)[..., 3].mean() < 1.0
        solid = (ours[..., 3] == 255) & (theirs[..., 3] == 255)
        difference = (ours - theirs)[solid][:, :3]
        assert np.abs(difference).mean() < 12
        assert np.percentile(np.abs(difference), 90) < 40
        geometry = Path(f"{path.parent}_geometry") / f"{path.stem}.npz"
        copied = Path(f"{other.parent}_geometry") / f"{other.stem}.npz"
        with np.load(geometry) as first, np.load(copied) as second:
            assert np.array_equal(first["depth"], second["depth"])


def test_without_blender_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("PCORE_BPY", raising=False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[blender\]"):
        blender_python()
    monkeypatch.undo()
    monkeypatch.setenv("PCORE_BPY", str(tmp_path / "no-python"))
    assert make(tmp_path, "-o", str(tmp_path / "out"), "--renderer", "blender") == 2
    assert "expected a Python that imports bpy" in capsys.readouterr().err
    assert (
        make(tmp_path, "-o", str(tmp_path / "out"), "--renderer", "blender", "--light", "baked")
        == 2
    )
    assert "expected --light fixed, got baked" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_blender_that_ends_early_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no module named bpy')")
    monkeypatch.setattr(blender_renderer.in_blender, "__file__", str(broken))
    monkeypatch.setenv("PCORE_BPY", sys.executable)
    assert make(tmp_path, "-o", str(tmp_path / "out"), "--renderer", "blender") == 2
    assert "ended with code 1: no module named bpy" in capsys.readouterr().err


def test_a_texture_that_blender_cannot_repeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCORE_BPY", sys.executable)
    texture = Texture(pixels=np.zeros((2, 2, 4), np.uint8), wrap=("repeat", "clamp"))
    look = Look(materials=(Material(texture=texture),), material_of_face=np.zeros(1, np.int64))
    with pytest.raises(InputError, match="got repeat and clamp"):
        blender(look, resolution=8)

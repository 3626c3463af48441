"""The page of public names: it has all of them, and its examples run."""

import json
import re
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.cli.toys import write_run, write_scene
from tests.seeded_runs import TWIST, write_moving_edit

import pcore
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.presets import gaussian_preset

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "index.md"


def blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("name", [name for name in pcore.__all__ if name != "__version__"])
def test_every_name_is_in_an_example(name: str) -> None:
    assert re.search(rf"\bpcore\.{name}\b", "".join(blocks()))


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "runs" / "papr", scene="../../ball", points=80)
    Path("edit.json").write_text(json.dumps({"version": 2, "edits": [TWIST]}))
    write_moving_edit(Path("moving.json"))
    code = compile("\n".join(blocks()), str(PAGE), "exec")
    exec(code, {"__name__": "reference"})
    assert (tmp_path / "runs" / "new-pcore" / "model.safetensors").is_file()


def gaussian_settings() -> GaussianConfig:
    return replace(gaussian_preset("tiny"), steps=6, points=150, save_every=6, validate_every=6)


@pytest.mark.parametrize("page", ["5-your-own-deformation", "6-your-own-training-loop"])
def test_tutorials_run_word_for_word(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = pcore.load_scene(write_scene(tmp_path / "ball"))
    toy = pcore.train(
        scene, gaussian_settings(), folder="runs/toy", options=pcore.RunOptions(light=False)
    )
    write_run(tmp_path / "runs" / "papr", scene="../../ball", points=80, surfels=True, factor=1)
    path = PAGE.parents[1] / "tutorials" / f"{page}.md"
    names: dict[str, Any] = {"__name__": "tutorial"}
    for block in re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, str(path), "exec"), names)
    if page.startswith("5"):
        assert abs(float(names["height"].grad)) > 0
        return
    mine, papr = pcore.load("runs/mine"), pcore.load("runs/mine-papr")
    assert mine.provenance.step == papr.provenance.step == 20
    assert mine.scene().name == papr.scene().name == "ball"
    assert mine.settings == toy.settings
    assert not torch.equal(mine.points, toy.points)
    assert "validation" not in mine.record.notes
    assert names["again"].settings == replace(gaussian_settings(), seed=1)


def test_pages_made_from_the_code_are_up_to_date() -> None:
    made = runpy.run_path(str(PAGE.parents[2] / "scripts" / "make_reference.py"))
    for name, page in (("names.md", "names_page"), ("edit-file.md", "edit_file_page")):
        written = (PAGE.parent / name).read_text(encoding="utf-8")
        assert written == made[page](), f"{name}: run `python scripts/make_reference.py`"

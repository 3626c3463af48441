"""The recipe of the paper's models: what is made of files that are there, and what to bring."""

from pathlib import Path

import pytest
import yaml
from benchmarks.paper_scenes import SETS
from figure_model import figure

from benchmarks import paper_models


def test_the_recipe_names_the_scenes_of_the_tables() -> None:
    models = yaml.safe_load(paper_models.RECIPE.read_text())["models"]
    pairs = tuple(name for name, one in models.items() if one["set"] == "objaverse")
    assert pairs == SETS["Objaverse"].scenes
    assert "realistic/{}" in SETS["Objaverse hand"].folders
    assert {"hand", "running"} == models.keys() - set(pairs)


def test_models_are_made_as_the_recipe_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "hand.glb").write_bytes(figure().content())
    words = [str(tmp_path), str(tmp_path / "data"), "--dry-run", "--", "--size", "64"]
    assert paper_models.main(words) == 1
    assert "expected one clip, got Bow, Stay; name one in" in capsys.readouterr().out
    named = tmp_path / "named.yaml"
    named.write_text(paper_models.RECIPE.read_text().replace("clip: only", "clip: Bow"))
    monkeypatch.setattr(paper_models, "RECIPE", named)
    assert paper_models.main(words) == 0
    out = capsys.readouterr().out
    assert "left out: butterfly: no " in out
    assert "bring a character of Mixamo" in out
    assert "--canonical Bow@0 --clips Bow@0.66 Bow@1.34 Bow@2 --state-train-views 0" in out
    assert out.index("--size 800") < out.index("--size 64")

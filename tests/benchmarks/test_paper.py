"""The paper's tables: data that is found or left out with a reason, means, quoted figures."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from benchmarks.paper_figures import NBS_QUOTED, TABLES
from benchmarks.paper_rows import nbs_parts, ours, table_csv, text_of
from benchmarks.paper_scenes import find

import published_sets
import tiny_scene
from benchmarks import paper
from pcore.capture.load import load_scene
from pcore.cli.main import main as pcore_main


def record(**states: float | None) -> dict[str, Any]:
    cells = {
        state: {"psnr": {"value": value}, "ssim": {"value": 0.9}, "lpips_alex": {"value": None}}
        for state, value in states.items()
    }
    kinds = {"canonical": "canonical", "twist": "analytic", "bend": "analytic", "run": "skeletal"}
    line = {"name": "PAPR", "setting": "given", "cells": cells, "cost": {"primitives": 3000}}
    return {"about": {"kinds": kinds}, "methods": [line]}


def test_means_are_over_states_of_the_kind_and_objects() -> None:
    two = [record(canonical=40.0, twist=20.0, bend=22.0), record(twist=30.0, bend=32.0)]
    assert ours(two, ["analytic"]) == [("PAPR (given)", (26.0, 0.9, None, "3,000"))]
    # A mean over fewer states than another method's would compare unlike things.
    assert ours([record(twist=20.0)], ["analytic"])[0][1][0] is None


def test_quoted_figures_say_so() -> None:
    table = TABLES["main"]
    rows = {"at hand": ours([record(twist=20.0, bend=22.0)], table.kinds)}
    lines = text_of(table, rows, ["toy"]).splitlines()
    assert "| at hand | PAPR (given) | 21.00 | 0.900 | - | 3,000 |" in lines
    assert "| Neural Editor | SC-GS - QUOTED | 18.55 | 0.832 | 0.123 | 236K |" in lines
    assert sum("QUOTED" in line for line in lines) == 12
    written = list(csv.DictReader(table_csv(table, rows).decode().splitlines()))
    assert [row["quoted"] for row in written] == ["no"] + ["yes"] * 12
    assert float(written[0]["psnr"]) == 21


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small sets in the layouts of the published ones, and one at hand."""
    root = tmp_path_factory.mktemp("data")
    published_sets.neural_editor(root / "made").rename(root / "made" / "chair")
    (root / "made").rename(root / "neural_editor")
    published_sets.pair(root / "objaverse" / "crab")
    published_sets.time_sequence(root / "realistic" / "hand")
    published_sets.dtu(root / "dtu")
    published_sets.mip_nerf_360(root / "360_v2")
    box = tiny_scene.write_scene(root / "deformed" / "box")
    tiny_scene.write_split(box / "walk", "train", tiny_scene.CORNERS, tiny_scene.orbit(4))
    return root


def test_published_sets_are_found_at_their_resolutions_and_splits(data: Path) -> None:
    found, skipped = find(data, ["DTU", "Mip-NeRF 360", "NeRF-Synthetic"], None, [])
    assert [(one.run, one.factor, one.size) for one in found] == [
        ("dtu-scan24", 1, (24, 16)),
        ("mip-nerf_360-garden", 8, (6, 4)),  # Half of the published images_4.
    ]
    assert found[0].note == "dtu-scan24: 24 x 16, the paper's are 800 wide"
    assert [one.name for one in skipped] == ["DTU", "Mip-NeRF 360", "NeRF-Synthetic"]
    assert skipped[0].reason.startswith("no scan37, scan40, ")
    assert skipped[2].reason.startswith("none of its scenes (looked for ")
    for one in found:
        scene = load_scene(one.path, factor=one.factor)
        assert [len(scene.split(name)) for name in ("train", "test")] == [14, 3]  # Every 8th.


def said(capsys: pytest.CaptureFixture[str], *words: str | Path) -> str:
    assert paper.main([str(word) for word in words]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("table", [*TABLES, *paper.OTHERS])
def test_every_table_has_a_help_and_a_line_that_says_how_long(
    table: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        paper.main([table, "--help"])
    assert ended.value.code == 0
    assert f"python -m benchmarks.paper {table} DATA RUNS" in capsys.readouterr().out
    guide = Path(__file__).parents[2] / "docs" / "research" / "paper-tables.md"
    assert f"| `{table} DATA RUNS` |" in guide.read_text(encoding="utf-8")


def test_a_dry_run_says_what_is_done_and_what_is_left_out(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny_scene.write_run(tmp_path / "box", data / "deformed" / "box")
    out = said(capsys, "main", data, tmp_path, "--dry-run")
    assert "done   pcore train" in out.replace(str(tmp_path), "")
    assert f"to do  pcore finetune {tmp_path / 'box'} -o {tmp_path / 'box-pcore'}" in out
    assert "--state grown -o" in out  # Of what is at hand analytic states alone.
    assert "--state box_data -o" in out
    assert "left out: objaverse-crab: no state that the table is about" in out
    assert "left out: Objaverse: no butterfly, dolphin" in out
    out = said(capsys, "nvs", data, tmp_path, "--dry-run", "--models", "papr", "--", "--every", "4")
    assert "--state canonical --methods papr 3dgs-fixed" in out
    assert "--every 4" in out
    assert "--factor 8" in out
    out = said(capsys, "motion", data, tmp_path, "--dry-run")
    assert "--state walk --methods papr motion" in out
    out = said(capsys, "ablation", data, tmp_path, "--dry-run", "--only", "box")
    assert f"pcore ablate {tmp_path / 'box'}" in out
    assert "left out: the user study" in said(capsys, "study", data, tmp_path)
    assert not (tmp_path / "paper").exists()


def test_a_table_with_a_line_for_every_picture(
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(paper, "run_pcore", lambda *words: pcore_main([*words]))
    for name in ("box", "neural_editor-chair"):
        scene = data / ("deformed/box" if name == "box" else "neural_editor/chair")
        tiny_scene.write_run(tmp_path / name, scene)
    words = ("main", data, tmp_path, "--models", "papr", "--", "--methods", "papr")
    out = said(capsys, *words)
    table = (tmp_path / "paper" / "main.md").read_text()
    assert table in out
    assert "| at hand | PAPR (given) | " in table
    assert "| Neural Editor | PAPR (given) | " in table
    assert "- left out: Objaverse: no butterfly" in table
    assert "- neural_editor-chair: 24 x 24, the paper's are 800 wide" in table
    with (tmp_path / "paper" / "main-images.csv").open(newline="") as file:
        images = list(csv.DictReader(file))
    where = {(row["data"], row["scene"], row["state"], row["view"]) for row in images}
    assert len(images) == len(where) == 2 * 2 * 2  # scenes, states, views
    assert ("Neural Editor", "chair", "box_data", "r_0") in where
    mean = sum(float(r["psnr"]) for r in images if r["state"] == "grown") / 2
    text = (tmp_path / "paper" / "main.csv").read_text()
    written = list(csv.DictReader(text.splitlines()))
    assert float(written[0]["psnr"]) == pytest.approx(mean)


def test_skinning_weights_and_their_pictures(tmp_path: Path) -> None:
    scores = dict.fromkeys(("psnr", "ssim", "chamfer", "emd", "f_01", "f_02"), 0.5)
    rows = [
        {"run": run, "state": "run", "method": "NBS", "scores": scores, "images": {"r_0": scores}}
        for run in ("knight", "knight-pcore")
    ]
    text, lines, pictures = nbs_parts(json.loads(json.dumps(rows)))
    assert "| at hand | NBS, renderer of P-CORE | 0.50 | 0.500 | - | 0.500" in text
    assert text.count("QUOTED") == len(NBS_QUOTED)
    assert lines.decode().count("\n") == 1 + 2 + len(NBS_QUOTED)
    assert [one["view"] for one in pictures] == ["r_0", "r_0"]

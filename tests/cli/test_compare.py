"""`pcore compare`: tables, files, going on, the field as files, and ways to ask wrongly."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.render.test_gaussian_surfels import a_ball

import tiny_scene
from gaussian_ball import ball_run
from pcore.cli.main import main
from pcore.data.points import load_points, read_point_file, save_points


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")


@pytest.fixture
def run(tmp_path: Path, scene: Path) -> Path:
    return tiny_scene.write_run(tmp_path / "run", scene)


def compare(*words: object) -> int:
    return main(["compare", *map(str, words), "--threads", "1"])


def test_runs_and_pictures_are_scored_alike(
    run: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    theirs = tmp_path / "theirs"
    shutil.copytree(scene / "test", theirs / "canonical")
    shutil.copytree(scene / "grown" / "test", theirs / "grown")
    words = (run, "--methods", "papr", "aware", "--pictures", f"Theirs={theirs}")
    assert compare(*words) == 0
    out = capsys.readouterr().out
    assert "foreground PSNR, dB" in out
    assert "note: Theirs, walk: " in out
    output = run / "compare"
    with (output / "compare.csv").open(newline="") as file:
        rows = {(row["method"], row["state"]): row for row in csv.DictReader(file)}
    assert {name for name, _ in rows} == {"PAPR", "aware", "Theirs"}
    assert float(rows["Theirs", "grown"]["psnr"]) > 60
    assert rows["Theirs", "walk"]["psnr"] == ""
    assert "expected a folder walk" in rows["Theirs", "walk"]["failed"]
    assert int(rows["PAPR", "canonical"]["primitives"]) == 60
    record = json.loads((output / "compare.json").read_text())
    assert record["status"] == "finished"
    assert "| PAPR | as given |" in (output / "compare.md").read_text()
    # The same again is read from the disk; what failed is tried again.
    kept = {one: one.stat().st_mtime_ns for one in (output / "rows").glob("PAPR*/*.json")}
    shutil.copytree(scene / "walk" / "test", theirs / "walk")
    assert compare(*words) == 0
    assert {one: one.stat().st_mtime_ns for one in kept} == kept
    assert "failed" not in capsys.readouterr().out


def test_failures_alone_are_a_failure(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (run, "--methods", "none", "--pictures", f"Theirs={tmp_path / 'none'}")
    assert compare(*words) == 2
    said = capsys.readouterr()
    assert "note: Theirs, canonical: --pictures Theirs=" in " ".join(said.out.split())
    assert "expected a method that can be scored, got failures only" in said.err
    assert "expected a folder, found none" in (run / "compare" / "compare.csv").read_text()


def test_the_field_as_files(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh, nodes = tmp_path / "mesh.ply", tmp_path / "nodes.npy"
    corners = torch.from_numpy(tiny_scene.CORNERS).float()
    save_points(mesh, corners, faces=torch.from_numpy(tiny_scene.FACES))
    np.save(nodes, a_ball().means.numpy())
    field = tmp_path / "field"
    given = (f"mesh={mesh}", f"nodes={nodes}")
    assert compare(run, "--export-field", field, "--points", *given) == 0
    assert "mesh: 8 points in 3 states" in capsys.readouterr().out
    grown = read_point_file(field / "mesh" / "grown.ply")
    torch.testing.assert_close(grown.positions.float(), 1.5 * corners)
    assert grown.faces is not None
    assert np.array_equal(grown.faces.numpy(), tiny_scene.FACES)
    moved = load_points(field / "nodes" / "grown.npy")
    torch.testing.assert_close(moved, 1.5 * a_ball().means)
    jacobians = np.load(field / "nodes" / "grown-jacobians.npy")
    np.testing.assert_allclose(jacobians, 1.5 * np.eye(3)[None].repeat(len(moved), 0), atol=1e-6)
    views = json.loads((field / "cameras.json").read_text())
    assert [one["picture"] for one in views[:3]] == [
        "canonical/r_0.png",
        "canonical/r_1.png",
        "grown/r_0.png",
    ]
    assert compare(run, "--export-field", field) == 2  # Not into what is there.


def test_own_points_where_no_files_are_given(run: Path, tmp_path: Path) -> None:
    field = tmp_path / "field"
    assert compare(run, "--export-field", field) == 0
    rest = load_points(field / "rest" / "run-points.ply")
    moved = load_points(field / "run-points" / "grown.ply")
    torch.testing.assert_close(moved, 1.5 * rest)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "sc-ga"], "--methods: expected some of papr, aware, light, 3dgs-fixed"),
        (["--methods", "3dgs-fixed", "--seconds", "0"], "--seconds: expected more than 0, got 0"),
        (["--methods", "none"], "got none: give pictures of other code with --pictures NAME=DIR"),
        (["--methods", "voxels", "--settings", "primitives"], "voxels needs --settings time"),
        (["--pictures", "x"], "--pictures: expected NAME=PATH, got x"),
        (["--pictures", "x=a", "x=b"], "--pictures: expected different names, got x, x"),
        (["--methods", "papr", "--pictures", "papr=a"], "papr=a: expected a name that no other"),
        (["--pictures", "SC GS=a", "SC gs=b"], "got that of 'SC GS'; choose another name"),
        (["--state", "wlak"], "no state 'wlak'"),
        (["--every", "0"], "--every: expected a whole number of at least 1, got 0"),
    ],
)
def test_wrong_options(
    run: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare(run, *words) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not [*run.glob("compare/rows/*")]


def test_pictures_may_have_the_name_of_a_method_that_is_not_compared(
    run: Path, scene: Path, tmp_path: Path
) -> None:
    shutil.copytree(scene / "test", tmp_path / "theirs" / "canonical")
    words = ("--pictures", f"PAPR={tmp_path / 'theirs'}")
    assert compare(run, "--methods", "none", *words) == 0
    kept = {path.name for path in run.glob("compare/rows/PAPR-*/*.json")}
    assert kept == {"canonical.json", "grown.json", "walk.json"}
    assert compare(run, "--methods", "aware", "papr", *words) == 2


def test_the_kind_of_run_that_is_lacking_is_named(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--scene", scene, "--factor", 1, "--methods", "papr", "motion")
    assert compare(ball_run(tmp_path / "ball"), *words) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "papr needs a run of points (`pcore train --model papr`); motion needs a run of" in said


def test_what_is_compared_must_be_of_one_scene(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare("--methods", "sc-gs") == 2
    assert "expected a RUN, or the folder of a scene" in " ".join(capsys.readouterr().err.split())
    other = tiny_scene.write_run(tmp_path / "other", tiny_scene.write_scene(tmp_path / "box2"))
    assert compare(run, other) == 2
    assert "expected runs of one scene" in " ".join(capsys.readouterr().err.split())
    assert compare(run, run.parent / "." / run.name) == 2
    assert "expected each RUN once" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    assert compare(run, "--methods", "papr", "-o", tmp_path / "mine") == 2
    assert "holds other files (notes.txt)" in " ".join(capsys.readouterr().err.split())

"""`pcore eval` on a box: files, table, baseline, and every way to ask for the wrong thing."""

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image
from torch import Tensor

import published_sets
import tiny_scene
from pcore.cli.main import main
from pcore.deform.jacobian import estimated_maps
from pcore.evaluation import states
from pcore.geometry.local_maps import LocalMaps


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")


@pytest.fixture
def run(tmp_path: Path, scene: Path) -> Path:
    return tiny_scene.write_run(tmp_path / "run", scene)


@pytest.fixture
def tuned(tmp_path: Path, scene: Path, run: Path) -> Path:
    return tiny_scene.write_run(
        tmp_path / "run-pcore", scene, stage="finetune", base=f"../{run.name}", factor=2
    )


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "images.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_tuned_run_is_compared_with_its_base(
    tuned: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", str(tuned), "--pictures"]) == 0
    out = capsys.readouterr().out
    assert "protocol papr" in out
    assert "protocol standard" in out
    assert "P-CORE against PAPR, mean of the analytic states (grown):" in out
    assert "mean of the skeletal states (walk):" in out
    rows = rows_of(tuned / "eval")
    assert len(rows) == 3 * 2 * 4 * 2  # states, views, methods, protocols
    methods = ["PAPR", "P-CORE", "aware", "aware + P-CORE"]
    assert list(dict.fromkeys(row["method"] for row in rows)) == methods
    canonical = [row for row in rows if row["state"] == "canonical"]
    psnr = {row["method"]: row["psnr"] for row in canonical}
    # Nothing is deformed there: the same picture to the last bit.
    assert psnr["aware"] == psnr["PAPR"]
    assert psnr["aware + P-CORE"] == psnr["P-CORE"]
    record = json.loads((tuned / "eval" / "summary.json").read_text())
    assert record["about"]["factor"] == 2  # of the training
    assert [gain["group"] for gain in record["gains"]] == ["analytic"] * 3 + ["skeletal"] * 3 + (
        ["analytic"] * 3 + ["skeletal"] * 3
    )
    assert "unseen: share of the object's pixels" in out
    for row in rows:
        # The box grows to one and a half; at rest nothing is strained.
        wanted = {"canonical": 1.0, "grown": 1.5}.get(row["state"])
        assert wanted is None or float(row["strain_99"]) == pytest.approx(wanted, rel=1e-4)
        assert float(row["self_intersection"]) == 0
        # What walks comes apart a little; the box that grows does not.
        assert 0 <= float(row["hole_score"]) <= (0.05 if row["state"] == "walk" else 0)
        assert 0 <= float(row["unseen"]) <= 1
    means = [one["scores"] for one in record["means"]]
    assert all(one["strain_max"] >= one["strain_99"] for one in means)
    against = {(gain["method"], gain["baseline"]) for gain in record["gains"]}
    assert against == {(method, "PAPR") for method in methods[1:]}
    pictures = sorted(path.name for path in (tuned / "eval" / "pictures").iterdir())
    assert pictures == [
        f"{state}-r_{view}.png" for state in ("canonical", "grown", "walk") for view in (0, 1)
    ]


def test_an_edit_is_scored_against_true_images_of_a_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = published_sets.pair(tmp_path / "pair")
    run = tiny_scene.write_run(tmp_path / "run", pair)
    grow = edit_file(tmp_path, "grow", {"type": "scale", "factor": 1.5})
    assert main(["eval", str(run), "--edit", str(grow), "--against", "end", "--rays", "both"]) == 0
    assert "aware against PAPR, mean of the edited states (edit:grow)" in capsys.readouterr().out
    rows = rows_of(run / "eval")
    assert [row["kind"] for row in rows[-8:]] == ["edited"] * 8
    assert all(row["psnr"] for row in rows)
    record = json.loads((run / "eval" / "summary.json").read_text())
    assert record["about"]["against"] == "end"
    assert main(["eval", str(run), "--edit", str(grow), "--against", "ende"]) == 2
    assert "no state 'ende' with true images; it has end" in capsys.readouterr().err
    assert main(["eval", str(run), "--against", "end"]) == 2
    assert "--against: expected --edit FILE" in capsys.readouterr().err


def test_a_time_stamp_is_a_state_to_score_against(tmp_path: Path, scene: Path) -> None:
    sequence = published_sets.time_sequence(tmp_path / "sequence")
    run = tiny_scene.write_run(tmp_path / "run", sequence)
    grow = edit_file(tmp_path, "grow", {"type": "scale", "factor": 1.125})
    words = ["--edit", str(grow), "--against", "t0.25", "--protocol", "standard"]
    assert main(["eval", str(run), *words]) == 0
    assert {row["state"] for row in rows_of(run / "eval")} == {"canonical", "edit:grow"}
    # Where the state's mesh is known, depth is scored, too.
    run = tiny_scene.write_run(tmp_path / "meshed", scene)
    assert main(["eval", str(run), "--edit", str(grow), "--against", "grown"]) == 0
    edited = [row for row in rows_of(run / "eval") if row["kind"] == "edited"]
    assert all(row["hole_rate"] for row in edited)


def test_one_photo_of_each_time_scores_what_was_learned_elsewhere(
    tmp_path: Path, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = published_sets.time_sequence(tmp_path / "alone", cameras_each=1)
    run = tiny_scene.write_run(tmp_path / "run", scene)
    grow = edit_file(tmp_path, "grow", {"type": "scale", "factor": 1.125})
    words = ["--scene", str(alone), "--edit", str(grow), "--against", "t0.25"]
    assert main(["eval", str(run), *words, "--protocol", "standard"]) == 0
    assert "one photo of the first time, 0, from which no" in " ".join(
        capsys.readouterr().out.split()
    )
    views = {(row["state"], row["view"]) for row in rows_of(run / "eval")}
    assert [state for state, _ in sorted(views)] == ["canonical", "edit:grow"]


def edit_file(folder: Path, name: str, *edits: dict) -> Path:
    path = folder / f"{name}.json"
    path.write_text(json.dumps({"version": 2, "edits": edits}))
    return path


def test_an_edit_file_is_a_state_without_a_truth(
    tuned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grow = edit_file(tmp_path, "grow", {"type": "scale", "factor": 4})
    near = {"near": [0.3, 0.3, 0.3], "to": [0.3, 0.3, 0.4]}
    drag = edit_file(
        tmp_path, "drag", {"type": "anchors", "handles": [near], "count": 50, "reach": 9}
    )
    words = ["--edit", str(grow), str(drag), "--protocol", "standard", "--pictures"]
    assert main(["eval", str(tuned), *words]) == 0
    out = capsys.readouterr().out
    assert "edit:grow" in out
    assert "no handle" in out
    rows = rows_of(tuned / "eval")
    assert len(rows) == 3 * 2 * 4  # states, views, methods: of the true states the canonical one
    for row in rows:
        truth, anchors = row["state"] == "canonical", row["state"] == "edit:drag"
        assert (row["psnr"] != "") == (row["see_through_rate"] != "") == truth
        assert (row["without_handle"] != "") == (row["anchors_disagree"] != "") == anchors
        assert 0 <= float(row["unseen"]) <= 1
        assert (row["kind"] == "edited") != truth
    (scaled,) = {
        (row["hole_score"], row["hole_score_plain"]) for row in rows if "grow" in row["state"]
    }
    assert tuple(map(float, scaled)) == (0, 1)
    assert max(float(row["without_handle"]) for row in rows if "drag" in row["state"]) > 0.1
    record = json.loads((tuned / "eval" / "summary.json").read_text())
    assert [one["scores"].get("psnr") is None for one in record["means"]] == [False] * 4 + [
        True
    ] * 8
    folder = tuned / "eval" / "pictures"
    sizes = {}
    for state in ("canonical", "edit_grow", "edit_drag"):
        with Image.open(folder / f"{state}-r_0.png") as image:
            sizes[state] = image.size
    # No column of a truth; a row more for handles.
    assert sizes["edit_grow"][0] < sizes["canonical"][0]
    assert sizes["edit_grow"][1] < sizes["edit_drag"][1]
    assert main(["info", str(tuned)]) == 0


def test_bad_edit_files(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    track = {"keyframes": [[0, 1], [2, 3]]}
    moving = edit_file(tmp_path, "moving", {"type": "scale", "factor": track})
    assert main(["eval", str(run), "--edit", str(moving)]) == 2
    assert "expected --time between 0 and 2" in capsys.readouterr().err
    assert main(["eval", str(run), "--edit", str(moving), str(moving), "--time", "1"]) == 2
    assert "--edit: expected files of different names, got" in capsys.readouterr().err
    fold = edit_file(tmp_path, "fold", {"type": "taper", "axis": "z", "factor": -9})
    assert main(["eval", str(run), "--edit", str(fold)]) == 2
    assert "singular deformation" in capsys.readouterr().err
    assert not (run / "eval").exists()


def test_a_pretrained_run_alone(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--state", "scale:2", "--protocol", "standard", "--factor", "2", "--rays", "plain"]
    assert main(["eval", str(run), *words]) == 0
    out = capsys.readouterr().out
    assert "8-bit images" in out
    assert "protocol papr" not in out
    assert "against" not in out
    rows = rows_of(run / "eval")
    assert {row["state"] for row in rows} == {"canonical", "scale:2"}
    assert {row["method"] for row in rows} == {"PAPR"}
    assert main(["info", str(run)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert re.search(r"object PSNR, PAPR canonical -?\d+\.\d\d dB, scale:2 -?\d+\.\d\d dB", told)


def test_why_lpips_is_missing(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("PCORE_LPIPS_DIR", "XDG_CACHE_HOME", "TORCH_HOME", "HOME"):
        monkeypatch.setenv(name, str(tmp_path / "nowhere"))
    assert main(["eval", str(run), "--state", "canonical", "--protocol", "papr"]) == 0
    out = capsys.readouterr().out
    assert "no LPIPS with alex, vgg: no weights; `pcore doctor --weights`" in out
    notes = json.loads((run / "eval" / "summary.json").read_text())["notes"]
    assert "lin_alex.pth" in notes[0]


def test_two_runs_of_one_kind_are_told_apart(run: Path, scene: Path, tmp_path: Path) -> None:
    other = tiny_scene.write_run(tmp_path / "other", scene)
    words = ["--baseline", str(other), "--state", "grown", "-o", str(tmp_path / "out")]
    assert main(["eval", str(run), *words]) == 0
    methods = {row["method"] for row in rows_of(tmp_path / "out")}
    assert methods == {f"{name} ({run})" for name in ("PAPR", "aware") for run in ("run", "other")}


def test_frames_that_had_to_be_replaced_are_in_the_notes(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def folded(rest: Tensor, moved: Tensor) -> LocalMaps:
        return replace(estimated_maps(rest, moved), mended=torch.tensor([1, 3]))

    monkeypatch.setattr(states, "estimated_maps", folded)
    assert main(["eval", str(run), "--state", "walk", "--protocol", "standard"]) == 0
    notes = json.loads((run / "eval" / "summary.json").read_text())["notes"]
    (note,) = [one for one in notes if "inside out" in one]
    assert note.startswith("state walk, aware: 2 of ")
    assert note.endswith("at points number 1, 3")
    assert "at points number 1, 3" in " ".join(capsys.readouterr().out.split())


def test_scaling_by_two_costs_nothing_with_aware_rays(run: Path) -> None:
    """Points and camera centres scaled together: the canonical picture, to rounding."""
    words = ["--state", "scale:2", "scale:0.5", "--protocol", "standard"]
    assert main(["eval", str(run), *words]) == 0
    rows = rows_of(run / "eval")
    assert all(
        row["mended_frames"] == "0"
        for row in rows
        if row["method"] == "aware" and row["state"] != "canonical"
    )
    psnr = {(row["method"], row["state"], row["view"]): float(row["psnr"]) for row in rows}
    views = {view for _, _, view in psnr}
    assert len(views) == 2
    for view in views:
        for state in ("scale:2", "scale:0.5"):
            found = psnr["aware", state, view]
            assert found == pytest.approx(psnr["aware", "canonical", view], abs=0.01)


def test_results_are_replaced_by_the_same_run_only(
    run: Path, tuned: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--state", "canonical", "-o", str(tmp_path / "out")]
    assert main(["eval", str(run), *words]) == 0
    assert main(["eval", str(run), *words]) == 0
    before = (tmp_path / "out" / "images.csv").read_bytes()
    capsys.readouterr()
    assert main(["eval", str(tuned), *words]) == 2
    said = capsys.readouterr().err
    assert f"holds the results of {run}, which are not overwritten by those of {tuned}" in said
    assert (tmp_path / "out" / "images.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--state", "twist"], "no state 'twist'; expected one of canonical, grown, walk, scale:S"),
        (["--state", "scale:-1"], "expected scale:S with a factor S > 0, got '-1'"),
        (["--factor", "5"], "factor"),
        (["--factor", "0"], "factor: expected a whole number of at least 1, got 0"),
        (["--scene", "nowhere"], "scene nowhere: no such folder"),
        (["--baseline", "nowhere"], "no run at nowhere"),
    ],
)
def test_bad_input(
    run: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", str(run), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (run / "eval").exists()


def test_a_run_whose_scene_is_gone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tiny_scene.write_run(tmp_path / "run", Path("gone"))
    assert main(["eval", str(run)]) == 2
    said = capsys.readouterr().err
    assert "the scene it was trained on (gone) is not a folder here" in said
    assert "--scene" in said


@pytest.mark.parametrize("state", ["", "grown"])
@pytest.mark.parametrize("harm", ["missing", "truncated"])
def test_test_images_are_checked_before_the_first_picture(
    tmp_path: Path, state: str, harm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tiny_scene.write_scene(tmp_path / "box")
    run, image = tiny_scene.write_run(tmp_path / "run", scene), scene / state / "test" / "r_1.png"
    if harm == "missing":
        image.unlink()
    else:
        image.write_bytes(image.read_bytes()[:-30])
    assert main(["eval", str(run)]) == 2
    said = capsys.readouterr().err
    assert str(image.with_suffix("")) in said
    assert ("no image at" if harm == "missing" else "truncated or damaged file") in said
    assert not (run / "eval").exists()


def test_a_scene_without_meshes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tiny_scene.write_scene(tmp_path / "plain", meshes=False)
    run = tiny_scene.write_run(tmp_path / "run", scene)
    assert main(["eval", str(run), "--state", "walk"]) == 2
    assert "'walk' has true images but no mesh in meshes.npz" in capsys.readouterr().err
    assert main(["eval", str(run)]) == 0
    assert "left out: grown, walk" in capsys.readouterr().out


def test_a_base_that_is_gone(
    tmp_path: Path, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned = tiny_scene.write_run(tmp_path / "tuned", scene, stage="finetune", base="../gone")
    assert main(["eval", str(tuned)]) == 2
    said = capsys.readouterr().err
    assert "was fine-tuned from" in said
    assert "give that run with --baseline" in said


@pytest.mark.parametrize("kind", ["run", "file"])
def test_an_output_that_is_something_else(
    run: Path, tuned: Path, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    target = tuned if kind == "run" else tmp_path / "file"
    assert main(["eval", str(run), "-o", str(target)]) == 2
    assert ("holds a run" if kind == "run" else "is a file") in capsys.readouterr().err


def test_files_of_others_are_not_overwritten(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    (out / "images.csv").write_text("name,price\n")
    assert main(["eval", str(run), "-o", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"{out} holds other files (images.csv): expected a new or empty folder" in said
    assert [(item.name, item.read_text()) for item in out.iterdir()] == [
        ("images.csv", "name,price\n")
    ]


def test_an_evaluation_that_was_killed_can_be_repeated(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tiny_scene.write_run(tmp_path / "set" / "run", scene)
    words = ["--state", "canonical", "--protocol", "papr", "--pictures", "-o"]

    def die(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pcore.evaluation.runner.measure", die)
        assert main(["eval", str(run), *words, str(tmp_path / "set" / "out")]) == 130
    summary = tmp_path / "moved" / "out" / "summary.json"
    # Results name their run as seen from themselves: both can move together.
    (tmp_path / "set").rename(tmp_path / "moved")
    assert json.loads(summary.read_text())["status"] == "not finished"
    monkeypatch.chdir(tmp_path / "moved")
    assert main(["eval", "run", *words, "out"]) == 0
    assert json.loads(summary.read_text())["about"]["run"] == "../run"

"""`pcore finetune`: a new run beside the old one, its settings, its scene, resuming."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from toys import CONFIG, logged_losses, write_run, write_scene

from pcore.cli.main import main
from pcore.files.model_file import load_model
from pcore.files.run_folder import RunFolder
from pcore.files.skinning_file import load_skinning
from pcore.training import finetune, objective
from pcore.training.presets import skinning_preset


@pytest.fixture
def base(tmp_path: Path) -> Path:
    """A pre-trained run, as far as it says itself."""
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "run", scene="../ball", preset="tiny", factor=2)
    return tmp_path / "run"


def call(run: Path, *args: object, steps: int = 2) -> int:
    options = ("--steps", steps, "--device", "cpu", "--threads", 1)
    return main(["finetune", str(run), *map(str, options), *map(str, args)])


def test_the_result_lies_beside_the_run_which_stays_as_it_is(
    base: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {item.name: item.read_bytes() for item in base.iterdir() if item.is_file()}
    assert call(base) == 0
    said = capsys.readouterr().out
    out = base.parent / "run-pcore"
    assert "ball: 12 training views of 8 x 8 pixels; tiny, 2 steps on cpu" in said
    assert f"next: pcore render {out} --edit edit.json" in said
    made = RunFolder.open(out)
    assert (made.stage, made.scene) == ("finetune", "../ball")
    assert (made.config["base"], made.config["factor"]) == ("../run", 2)
    assert made.config["finetune"]["steps"] == 2
    assert made.notes["status"] == "finished"
    assert {item.name: item.read_bytes() for item in base.iterdir() if item.is_file()} == before
    tuned, vanilla = load_model(out), load_model(base)
    assert (tuned.provenance.stage, tuned.provenance.step) == ("finetune", 2)
    changed = [n for n, v in vanilla.papr_state.items() if not torch.equal(tuned.papr_state[n], v)]
    assert changed


def test_networks_are_compiled_unless_told_otherwise(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(finetune, "compile_networks", lambda device, *nets: asked.append(nets))
    assert call(base, "-o", tmp_path / "one", steps=1) == 0
    assert len(asked) == 1
    assert call(base, "-o", tmp_path / "two", "--no-compile", steps=1) == 0
    assert len(asked) == 1


def test_settings_of_an_imported_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It has no scene on record, and the preset of the paper."""
    write_run(tmp_path / "run", scene="chair", config=replace(CONFIG, background=(0.0, 0.0, 0.0)))
    assert call(tmp_path / "run") == 2
    said = capsys.readouterr().err
    assert "the scene it was trained on (chair) is not a folder here" in said
    assert "--scene" in said
    scene, out = write_scene(tmp_path / "ball"), tmp_path / "out"
    options = ("--scene", scene, "--preset", "tiny", "--seed", 3, "-o", out)
    assert call(tmp_path / "run", *options, steps=1) == 0
    config = RunFolder.open(out).config
    assert (config["preset"], config["factor"]) == ("tiny", 1)
    assert (config["finetune"]["seed"], config["finetune"]["background"]) == (3, "black")


def test_weights_of_losses_are_options(base: Path) -> None:
    options = ("--opacity-weight", 0.25, "--front-weight", 0, "--lpips-weight", 0)
    assert call(base, *options, steps=1) == 0
    found = RunFolder.open(base.parent / "run-pcore").config["finetune"]
    assert (found["opacity_weight"], found["front_weight"]) == (0.25, 0)
    assert logged_losses(base.parent / "run-pcore") >= {"rgb", "opacity"}
    assert "front" not in logged_losses(base.parent / "run-pcore")


@pytest.mark.parametrize("recipe", ["ours", "paper"])
def test_skinning_learns_along(
    tmp_path: Path, recipe: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "run", scene="../ball", preset="tiny", factor=2, points=140)
    options = () if recipe == "ours" else ("--skinning-recipe", recipe)
    assert call(tmp_path / "run", "--skinning", *options, steps=2) == 0
    out = tmp_path / "run-pcore"
    skinning = load_skinning(out, load_model(out).cloud.positions)
    assert len(skinning.anchors) == 128
    assert skinning.network.config == skinning_preset(recipe).network  # pyright: ignore[reportArgumentType]
    assert ("skinning" in logged_losses(out)) is (recipe == "ours")
    capsys.readouterr()
    assert main(["info", str(out), "--settings"]) == 0
    rows = {line.split(maxsplit=1)[0]: line for line in capsys.readouterr().out.splitlines()}
    assert rows["config.finetune.skinning.anchors"].split()[-1] == "128"
    assert rows["skinning.along_cloud"].split()[-1] == ("true" if recipe == "ours" else "false")
    assert "learned weights of 128 anchors" in rows["skinning"]


def test_too_few_points_for_anchors(base: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(base, "--skinning") == 2
    assert "expected at least 128 points to choose from, got 40" in capsys.readouterr().err
    assert not (base.parent / "run-pcore").exists()


def test_the_preset_of_a_run_without_one_is_the_papers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "run", scene="../ball")
    seen: list[object] = []

    def note(*args: object, **options: object) -> None:
        seen.append(args)

    monkeypatch.setattr("pcore.asset.training.finetune", note)
    monkeypatch.setattr("pcore.cli.sessions.show_result", note)
    monkeypatch.setattr("pcore.cli.finetune.check_weights", note)
    monkeypatch.setattr("pcore.cli.sessions.show_light", note)
    assert call(tmp_path / "run") == 0
    assert "; paper, 2 steps" in capsys.readouterr().out


def test_resuming_equals_never_stopping(
    base: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert call(base, "-o", whole, steps=4) == 0
    original, count = objective.draw_patch, [0]

    def draw(*args: object, **options: object) -> object:
        count[0] += 1
        if count[0] == 2:
            signal.raise_signal(signal.SIGINT)
        return original(*args, **options)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(objective, "draw_patch", draw)
    assert call(base, "-o", broken, steps=4) == 130
    assert f"is saved in {broken}" in capsys.readouterr().err
    assert call(base, "-o", broken, "--resume", steps=4) == 0
    expected = load_model(whole).papr_state
    for name, value in load_model(broken).papr_state.items():
        assert torch.equal(value, expected[name]), name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "."), "a folder other than that of the run it starts from"),
        (("--scene", "absent"), "absent: no such folder"),
        (("--factor", "3"), "16 x 16 images cannot be divided by 3"),
        (("--resume",), "nothing to resume"),
        (("--steps", "0"), "expected steps >= 1, got 0"),
        (("--front-weight", "-1"), "front_weight to be a finite number of 0 or more, got -1"),
        (("--skinning-recipe", "paper"), "expected --skinning as well"),
        (("--lpips-trunk", "vgg"), "--lpips-trunk vgg: expected an LPIPS loss, got the weight 0"),
    ],
)
def test_bad_options(
    base: Path,
    options: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(base)
    assert call(Path(), *options) == 2
    assert message in capsys.readouterr().err
    assert not (base.parent / "run-pcore" / "run.json").exists()


def test_a_run_given_as_a_dot(base: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(base)
    assert call(Path(), steps=1) == 0
    assert RunFolder.open(base.parent / "run-pcore").config["base"] == "../run"


def test_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path) == 2
    assert f"no run at {tmp_path}" in capsys.readouterr().err

"""`pcore train`: options, logs, resuming, and a folder left clean when nothing can begin."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import pytest
import torch
from toys import logged_losses, write_scene

from pcore.cli import minutes
from pcore.cli.main import main
from pcore.data.points import save_points
from pcore.files.gaussian_file import load_gaussians
from pcore.files.model_file import load_model
from pcore.files.run_folder import RunFolder
from pcore.training.speed import Speed
from pcore.training.time_plan import Photos, TimePlan


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return write_scene(tmp_path / "ball")


def call(scene: Path, run: Path, *args: object, steps: int = 3) -> int:
    given = ["--steps", steps, "--device", "cpu", "--threads", 1]
    given += [] if "--init" in args else ["--points", 60]
    words = ["train", str(scene), "-o", str(run), "--model", "papr"]
    return main([*words, *map(str, given), *map(str, args)])


def logged(run: Path, kind: str) -> list[int]:
    lines = (run / "log.jsonl").read_text().splitlines()
    return [one["step"] for one in map(json.loads, lines) if one["event"] == kind]


def weights(run: Path) -> dict[str, torch.Tensor]:
    model = load_model(run)
    return {**model.papr_state, "positions": model.cloud.positions, "mu": model.cloud.features}


def test_training_makes_a_run(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert call(scene, run, "--factor", 2, "--seed", 5) == 0
    said = capsys.readouterr().out
    assert "ball: 12 training views of 8 x 8 pixels; tiny, 3 steps on cpu" in said
    assert "pretrain 3/3" in said
    assert f"next: pcore render {run} --edit edit.json" in said
    assert f"the paper's method, for plain rays: pcore finetune {run}" in said
    assert "dB on held-out training views" in said
    folder = RunFolder.open(run)
    assert (folder.stage, folder.scene) == ("pretrain", "../ball")
    assert (folder.config["preset"], folder.config["factor"]) == ("tiny", 2)
    assert folder.config["pretrain"]["seed"] == 5
    assert folder.notes["status"] == "finished"
    assert load_model(run).cloud.positions.shape == (60, 3)
    assert logged(run, "step")[-1] == 3
    assert any((run / "tensorboard").iterdir())


@pytest.mark.parametrize("model", ["papr", "gaussians"])
@pytest.mark.parametrize("place", ["run", "train/deep/run"])
def test_a_run_never_lies_in_the_scene(
    model: str, place: str, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(scene.rglob("*"))
    assert call(scene, scene / place, "--model", model) == 2
    assert "never written to" in " ".join(capsys.readouterr().err.split())
    assert sorted(scene.rglob("*")) == before


def test_options_change_the_preset(scene: Path, tmp_path: Path) -> None:
    start = torch.randn(9, 3) * 0.3
    save_points(tmp_path / "start.npy", start)
    run = tmp_path / "run"
    options = ("--init", tmp_path / "start.npy", "--background", "black", "--no-tensorboard")
    assert call(scene, run, *options, "--origin", "camera", steps=1) == 0
    model = load_model(run)
    assert model.config.reference is None
    assert model.config.background == (0, 0, 0)
    assert model.cloud.positions.shape == (9, 3)
    assert float((model.cloud.positions - start).abs().max()) < 0.01
    assert not (run / "tensorboard").exists()


def test_hazy_masks_are_said(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They start points all around the object; a grid does not care."""
    assert call(scene, tmp_path / "clean", steps=1) == 0
    assert "masks are" not in capsys.readouterr().out
    for path in (scene / "train").glob("*.png"):
        picture = iio.imread(path)
        picture[..., 3] = picture[..., 3].clip(30)
        iio.imwrite(path, picture)
    assert call(scene, tmp_path / "hazy", steps=1) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "warning: the masks are hazy: for 100 pixels that show the object," in said
    assert "clean the alpha channels, or start without them: --init grid" in said
    assert call(scene, tmp_path / "grid", "--init", "grid", "--points", 60, steps=1) == 0
    assert "masks are" not in capsys.readouterr().out


def test_networks_are_compiled_unless_told_otherwise(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(
        "pcore.training.pretrain.compile_networks", lambda device, *networks: asked.append(networks)
    )
    assert call(scene, tmp_path / "one", "--no-tensorboard", steps=1) == 0
    assert len(asked) == 1
    assert call(scene, tmp_path / "two", "--no-tensorboard", "--no-compile", steps=1) == 0
    assert len(asked) == 1


def test_weights_of_losses_are_options(scene: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert call(scene, run, "--opacity-weight", 0, "--front-weight", 0.2, steps=1) == 0
    found = RunFolder.open(run).config["pretrain"]
    assert (found["opacity_weight"], found["front_weight"]) == (0, 0.2)
    assert logged_losses(run) == {"rgb", "front"}


def test_an_opacity_loss_needs_alpha(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path / "photos", alpha=False)
    assert call(scene, tmp_path / "run", "--opacity-weight", 0.1) == 2
    assert "expected images with an alpha channel to compare" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_missing_test_image_does_not_keep_from_training(scene: Path, tmp_path: Path) -> None:
    (scene / "test" / "r_0.png").unlink()
    (scene / "test" / "r_1.png").write_bytes(b"damaged")
    assert call(scene, tmp_path / "run", steps=1) == 0


def test_photos_without_alpha_start_on_a_grid(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path / "photos", alpha=False)
    assert call(scene, tmp_path / "run", steps=1) == 0
    assert "points start on a grid" in capsys.readouterr().out
    assert RunFolder.open(tmp_path / "run").config["pretrain"]["start"] == "grid"


def test_training_goes_on_without_the_tensorboard_package(
    scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard.writer", None)
    assert call(scene, tmp_path / "run", steps=1) == 0
    assert "pip install 'pcore-edit[log]'" in capsys.readouterr().out


# --- interruption and resuming -------------------------------------------------------------


@pytest.fixture
def ctrl_c_at(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Press Ctrl-C when so many steps are done."""
    import signal

    from pcore.training import pretrain

    def arm(step: int) -> None:
        original, count = pretrain.draw_patch, [0]

        def draw(*args: object, **options: object) -> object:
            count[0] += 1
            if count[0] == step:
                signal.raise_signal(signal.SIGINT)
            return original(*args, **options)  # pyright: ignore[reportArgumentType]

        monkeypatch.setattr(pretrain, "draw_patch", draw)

    return arm


def test_ctrl_c_before_the_first_step_leaves_nothing(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pcore.asset import training

    def stop(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    path = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(training, "pretrain", stop)
        assert call(scene, path, steps=1) == 130
    assert not path.exists()
    assert call(scene, path, steps=1) == 0


def test_a_resumed_run_equals_one_that_was_never_interrupted(
    scene: Path,
    tmp_path: Path,
    ctrl_c_at: Callable[[int], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert call(scene, whole, steps=6) == 0
    ctrl_c_at(3)
    assert call(scene, broken, steps=6) == 130
    said = capsys.readouterr()
    assert f"step 3 is saved in {broken}" in said.err
    assert "the same command goes on from there" in said.err
    assert RunFolder.open(broken).notes["status"] == "stopped"
    assert call(scene, broken, "--resume", steps=6) == 0
    assert "goes on from step 3" in capsys.readouterr().out
    assert logged(broken, "step")[-1] == 6
    expected = weights(whole)
    for name, value in weights(broken).items():
        assert torch.equal(value, expected[name]), name


def test_resuming_what_is_finished_changes_nothing(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert call(scene, run) == 0
    before = (run / "model.safetensors").stat().st_mtime_ns
    assert call(scene, run, "--resume") == 0
    assert "finished already" in capsys.readouterr().out
    assert (run / "model.safetensors").stat().st_mtime_ns == before
    assert call(scene, run, "--resume", "--seed", 1) == 2
    assert "pretrain.seed: 0 -> 1" in capsys.readouterr().err


def test_another_run_is_not_overwritten(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert call(scene, run, steps=1) == 0
    assert call(scene, run, steps=1) == 2
    assert f"{run} holds a run already" in capsys.readouterr().err
    assert call(scene, tmp_path / "new", "--resume") == 2
    assert "nothing to resume" in capsys.readouterr().err
    assert call(scene, scene) == 2
    assert f"{scene} holds other files" in capsys.readouterr().err


# --- errors before anything is written -----------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--factor", "3"), "16 x 16 images cannot be divided by 3"),
        (("--points", "0"), "expected points >= 1, got 0"),
        (("--init", "absent.ply"), "absent.ply: no such file"),
        (("--init", "hul"), "expected a file of points that ends in .npy or .ply"),
        (("--init", "sparse"), "--init sparse: expected options of PAPR"),
        (("--init", "views"), "--init views: expected options of PAPR"),
        (("--preset", "paper"), "LPIPS"),
        (("--lpips-weight", "0.1", "--lpips-trunk", "alex"), "lin_alex.pth"),
        (("--lpips-weight", "nan"), "lpips_weight to be a finite number of 0 or more, got nan"),
        (("--opacity-weight", "-0.1"), "opacity_weight to be a finite number of 0 or more"),
    ],
)
def test_what_cannot_begin_leaves_no_run(
    scene: Path,
    tmp_path: Path,
    options: tuple[str, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("PCORE_LPIPS_DIR", "XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "empty"))
    run = tmp_path / "run"
    assert call(scene, run, *options) == 2
    assert message in capsys.readouterr().err
    assert not (run / "run.json").exists()
    assert not (run / "log.jsonl").exists()
    assert call(scene, run, steps=1) == 0


def test_no_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path / "absent", tmp_path / "run") == 2
    assert "absent: no such folder" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_a_full_disk_in_the_middle_keeps_what_was_saved(
    scene: Path,
    tmp_path: Path,
    ctrl_c_at: Callable[[int], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = tmp_path / "run"
    ctrl_c_at(2)
    assert call(scene, run, steps=4) == 130
    before = (run / "state.pt").read_bytes()

    def full(*args: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pcore.files.training_state.write_atomically", full)
    assert call(scene, run, "--resume", steps=4) == 2
    assert "space" in capsys.readouterr().err.lower()
    assert (run / "state.pt").read_bytes() == before
    assert RunFolder.open(run).saved_step() == 2


def test_gaussians_are_trained_and_resumed_by_the_same_verb(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert call(scene, run, "--model", "gaussians") == 0
    said = capsys.readouterr().out
    assert "Gaussians, tiny, 3 steps on cpu" in said
    assert "dB on held-out training views" in said
    folder = RunFolder.open(run)
    assert (folder.config["model"], folder.config["gaussians"]["points"]) == ("gaussians", 60)
    assert folder.notes["status"] == "finished"
    assert not folder.model.exists()
    assert len(load_gaussians(run).gaussians) == 60
    assert call(scene, run, "--model", "gaussians", "--resume") == 0
    assert "finished already" in capsys.readouterr().out
    assert main(["info", str(run)]) == 0
    assert "degree of the harmonics" in capsys.readouterr().out


def test_options_that_only_papr_has_are_refused_for_gaussians(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    for wrong in (["--origin", "camera"], ["--front-weight", 1], ["--preset", "paper"]):
        assert call(scene, run, "--model", "gaussians", *wrong) == 2
        assert "Gaussians" in capsys.readouterr().err
        assert not run.exists()


def test_flat_gaussians_are_trained_and_refused_for_papr(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert call(scene, run, "--model", "papr", "--flat") == 2
    assert "--model gaussians" in capsys.readouterr().err
    assert not run.exists()
    assert call(scene, run, "--model", "gaussians", "--flat", steps=2) == 0
    assert load_gaussians(run).footprint.flat
    assert main(["info", str(run)]) == 0


def test_a_promise_of_minutes_says_its_plan_and_resumes_it(
    scene: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def plan(
        photos: Photos, speed: object, seconds: float, base: Any, **rest: object
    ) -> TimePlan[Any]:
        assert 0 < seconds < 60 * 3
        assert (photos.width, photos.count) == (16, 12)
        return TimePlan(factor=1, config=replace(base, steps=40, points=60, seconds=0.5))

    monkeypatch.setattr(minutes, "plan_gaussians", plan)
    monkeypatch.setattr(minutes, "measured_speed", lambda *others: Speed())
    run = tmp_path / "run"
    command = ["train", str(scene), "-o", str(run), "--model", "gaussians", "--minutes", "3"]
    assert main([*command, "--steps", "3"]) == 2
    assert "leave one of them out" in capsys.readouterr().err
    assert main([*command[:-1], "-1"]) == 2
    assert not run.exists()
    assert main(command) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "3 minutes: photos 16 x 16, 60 to 10,000 Gaussians, about 40 steps" in said
    assert "the number of steps follows the clock" in said
    folder = RunFolder.open(run)
    assert folder.config["gaussians"]["seconds"] == 0.5
    assert folder.notes["status"] == "finished"
    # The plan is the run's own, whatever this machine would plan now.
    assert main([*command, "--resume"]) == 0
    assert "finished already" in capsys.readouterr().out

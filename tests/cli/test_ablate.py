"""`pcore ablate` on a box with a training of a few steps."""

import json
from pathlib import Path

import pytest
from PIL import Image

import pcore
import tiny_scene
from pcore.asset.training import RunOptions
from pcore.cli.main import main
from pcore.evaluation.ablation import GAUSSIAN_VARIANTS
from pcore.training import presets
from pcore.training.config import FinetuneConfig, PatchConfig, Rates
from pcore.training.gaussian_config import GaussianConfig, GaussianFinetuneConfig
from pcore.training.schedule import Schedule

RATE = Schedule(base=1e-3)
SHORT = FinetuneConfig(
    steps=2,
    patch=PatchConfig(side=8),
    rates=Rates(points=RATE, attention=RATE, features=RATE, influence=RATE, unet=RATE),
)
FOLDERS = ("full", "without-points", "without-rays", "without-texture")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")


@pytest.fixture
def run(tmp_path: Path, scene: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(presets, "finetune_preset", lambda name: SHORT, raising=False)
    return tiny_scene.write_run(tmp_path / "run", scene, preset="tiny")


def test_all_variants_are_trained_once_scored_and_drawn(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (run / "model.safetensors").read_bytes()
    assert main(["ablate", str(run)]) == 0
    output = run / "ablation"
    assert "w/o R&P against PAPR" in capsys.readouterr().out
    settings = {
        name: json.loads((output / name / "run.json").read_text())["config"] for name in FOLDERS
    }
    tuning = {name: config["finetune"] for name, config in settings.items()}
    assert [tuning[name]["rays_and_points"] for name in FOLDERS] == [True, True, False, True]
    assert [tuning[name]["points_only"] for name in FOLDERS] == [True, False, True, True]
    assert tuning["without-texture"]["texture_weight"] == 0
    assert tuning["full"]["texture_weight"] > 0
    assert settings["full"]["base"] == "../.."
    record = json.loads((output / "summary.json").read_text())
    methods = list(dict.fromkeys(mean["method"] for mean in record["means"]))
    assert methods == ["PAPR", "Photos only", "w/o R&P", "w/o Pt-Only", "w/o L_tex", "Full"]
    assert {mean["state"] for mean in record["means"]} == {"canonical", "scale:2"}
    with Image.open(output / "ablation.png") as figure:
        assert figure.width > 6 * 200
        assert figure.height > 2 * 200
    assert (run / "model.safetensors").read_bytes() == before

    words = ["ablate", str(run), "--state", "walk"]
    models = [output / name / "model.safetensors" for name in FOLDERS]
    made = [path.stat().st_mtime_ns for path in models]
    assert main(words) == 0
    assert capsys.readouterr().out.count("finished already") == 5
    assert [path.stat().st_mtime_ns for path in models] == made
    record = json.loads((output / "summary.json").read_text())
    assert {mean["state"] for mean in record["means"]} == {"canonical", "walk"}
    assert main([*words, "--steps", "3"]) == 2
    assert "finetune.steps: 2 -> 3" in capsys.readouterr().err


def test_gaussians_have_the_same_ablation_and_their_regularisers(
    tmp_path: Path, scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = GaussianFinetuneConfig(steps=1, rays=20)
    monkeypatch.setattr(presets, "gaussian_finetune_preset", lambda name: short, raising=False)
    run = tmp_path / "run"
    start = GaussianConfig(steps=2, points=40)
    options = RunOptions(light=False)
    pcore.train(pcore.load_scene(scene), start, folder=run, options=options)
    assert main(["ablate", str(run)]) == 0
    assert "Full against Gaussians" in capsys.readouterr().out
    record = json.loads((run / "ablation" / "summary.json").read_text())
    methods = list(dict.fromkeys(mean["method"] for mean in record["means"]))
    assert methods[0] == "Gaussians"
    assert methods[1:] == [variant.title for variant in GAUSSIAN_VARIANTS]
    tuning = json.loads((run / "ablation" / "with-spread" / "run.json").read_text())["config"]
    assert tuning["finetune"]["spread_weight"] == 1
    with Image.open(run / "ablation" / "ablation.png") as figure:
        assert figure.width > (2 + len(GAUSSIAN_VARIANTS)) * 200


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--state", "twist"], "no state 'twist'; expected one of"),
        (["--state", "canonical"], "no deformed state to score; give --state scale:2"),
        (["--view", "2"], "--view: expected a number from 0 to 1"),
    ],
)
def test_bad_input_is_found_before_any_training(
    run: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ablate", str(run), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (run / "ablation").exists()

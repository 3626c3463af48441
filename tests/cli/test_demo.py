"""`pcore demo` on a box in place of the sample, with trainings of a few steps."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

import tiny_scene
from pcore.cli.demo import make_demo
from pcore.cli.main import main
from pcore.demo import demo_settings
from pcore.demo.demo_folder import DemoFolder, stamp_of
from pcore.demo.demo_settings import DemoSettings
from pcore.demo.machine import peak_memory
from pcore.errors import DependencyError, InputError
from pcore.evaluation import report
from pcore.sample import sample
from pcore.training.config import FinetuneConfig, PatchConfig, PretrainConfig, Rates
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.schedule import Schedule

RATE = Schedule(base=1e-3)
RATES = Rates(points=RATE, attention=RATE, features=RATE, influence=RATE, unet=RATE)
SETTINGS = DemoSettings(
    gaussians=GaussianConfig(steps=3, points=40, hold_out=3),
    pretrain=PretrainConfig(
        model=tiny_scene.CONFIG,
        steps=3,
        patch=PatchConfig(side=8),
        rates=RATES,
        points=40,
        influence_start=1.0,
        hold_out=3,
    ),
    finetune=FinetuneConfig(steps=2, patch=PatchConfig(side=8), rates=RATES, hold_out=3),
    resolution=24,
    train_views=6,
    test_views=2,
    frames=3,
    shown=(1,),
)
FILES = (
    *("canonical.mp4", "deformed.mp4", "eval/summary.json", "papr/model.safetensors"),
    "gaussians/gaussians.safetensors",
)


@pytest.fixture(autouse=True)
def _box_for_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    def make_box(root: Path, **settings: object) -> Path:
        if not root.exists():
            names = ("twist60", "bend60", "stretch", "scale2x")
            tiny_scene.write_scene(root, names=names)
        return root

    monkeypatch.setattr(sample, "make_sample", make_box)
    monkeypatch.setattr(demo_settings, "default_settings", lambda: SETTINGS)


def test_the_whole_story(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "demo"
    assert main(["demo", "-o", str(folder)]) == 0
    out = capsys.readouterr().out
    assert f"Report: {folder / 'report.html'}" in out
    assert "6/7 videos" in out
    assert "dB on the edited object by Gaussians affine. Mean PSNR" in out
    page = (folder / "report.html").read_text()
    assert page.count("data:video/mp4;base64,") == 2
    # States and panels; nothing is strained at rest.
    assert page.count("data:image/png;base64,") == 5 * 13 - 1
    for text in ("Twist, 60°", "Bend, 60°", "Stretch", "Canonical", "pcore train MY_SCENE"):
        assert text in page
    for name in FILES:
        assert (folder / name).stat().st_size > 0
    record = json.loads((folder / "demo.json").read_text())
    assert record["peak_memory"] > 1e7
    assert set(record["stages"]) == {
        "sample",
        "Gaussians",
        "pre-training",
        "fine-tuning",
        "evaluation",
        "videos",
    }
    # Both runs are runs like any other.
    assert main(["eval", str(folder / "pcore"), "--state", "stretch", "--protocol", "papr"]) == 0


def test_a_second_time_reuses_everything_but_makes_what_is_missing(tmp_path: Path) -> None:
    folder, console = tmp_path / "demo", Console(quiet=True)
    page = make_demo(folder, SETTINGS, console, device="cpu")
    before = {name: (folder / name).stat().st_mtime_ns for name in FILES}
    first = page.read_text()
    page.unlink()
    (folder / "deformed.mp4").unlink()
    make_demo(folder, SETTINGS, console, device="cpu")
    after = {name: (folder / name).stat().st_mtime_ns for name in FILES}
    changed = {name for name in FILES if before[name] != after[name]}
    assert changed == {"canonical.mp4", "deformed.mp4"}
    assert page.read_text().count("data:") == first.count("data:")
    # Finished runs are not mixed with those of other settings.
    other = replace(SETTINGS, finetune=replace(SETTINGS.finetune, steps=4))
    with pytest.raises(InputError, match=r"finetune\.steps: 2 -> 4"):
        make_demo(folder, other, console, device="cpu")


def test_a_folder_that_holds_something_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert main(["demo", "-o", str(tmp_path)]) == 2
    assert "holds other files (thesis.txt): expected an empty place" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
    assert main(["demo", "-o", str(tmp_path / "thesis.txt")]) == 2
    assert "is a file: expected a folder for the demo" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["", "[]", '{"format": "pcore-demo", "version": 9}'])
def test_a_record_of_something_else(tmp_path: Path, content: str) -> None:
    (tmp_path / "demo.json").write_text(content)
    with pytest.raises(InputError, match="expected the record of a demo"):
        DemoFolder.open(tmp_path)


def test_missing_extras_are_said_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing() -> None:
        raise DependencyError("the HTML report needs jinja2")

    monkeypatch.setattr(report, "require_jinja", missing)
    assert main(["demo", "-o", str(tmp_path / "demo")]) == 2
    assert "needs jinja2" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


def test_time_counts_over_interruptions_and_only_the_end_is_done(tmp_path: Path) -> None:
    folder = DemoFolder.open(tmp_path / "demo")
    with pytest.raises(KeyboardInterrupt), folder.timed("sample", "a"):
        raise KeyboardInterrupt
    assert not folder.done("sample", "a")
    with folder.timed("sample", "a"):
        pass
    again = DemoFolder.open(tmp_path / "demo")
    assert again.done("sample", "a")
    assert not again.done("sample", "b")
    assert again.seconds["sample"] >= 0
    assert again.peak_memory == pytest.approx(peak_memory(), rel=0.5)


def test_stamps_see_every_part(tmp_path: Path) -> None:
    file = tmp_path / "model"
    file.write_bytes(b"one")
    first = stamp_of(file, {"steps": 3})
    assert stamp_of(file, {"steps": 3}) == first
    assert stamp_of(file, {"steps": 4}) != first
    file.write_bytes(b"two")
    assert stamp_of(file, {"steps": 3}) != first

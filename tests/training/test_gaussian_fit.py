"""Training of Gaussians: it learns, is the same every time, goes on where it stopped."""

from __future__ import annotations

import json
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio.v3 as iio
import pytest
import torch

import pcore.data.images
from pcore.capture.load import load_scene
from pcore.data.points import save_points
from pcore.data.scene import Scene, hold_out
from pcore.errors import CheckpointError, InputError
from pcore.files.gaussian_file import load_gaussians
from pcore.files.run_folder import RunFolder
from pcore.gaussians.render import Footprint
from pcore.gaussians.wide_pixels import pixel_width
from pcore.training.events import Event, PopulationReport, StepReport, ValidationReport
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.gaussian_start import camera_distance, mean_colors, start_gaussians
from pcore.training.presets import gaussian_preset
from pcore.training.schedule import Level
from pcore.training.trainable_gaussians import TrainedGaussians
from small_training import Heard, assert_same, box_work
from tiny_scene import write_scene

LEVELS = (Level(until=0.6, reduction=2),)
DENSITY = DensityConfig(every=10, first=10, last=0.8, gradient=1e-6, limit=150)


def config(**changes: Any) -> GaussianConfig:
    settings: dict[str, Any] = {
        "steps": 40,
        "points": 100,
        "density": DENSITY,
        "validate_every": 20,
        "save_every": 15,
        "hold_out": 3,
        "seed": 3,
    }
    return GaussianConfig(**{**settings, **changes})


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return load_scene(write_scene(tmp_path / "box", states=False))


def tensors(found: TrainedGaussians) -> dict[str, torch.Tensor]:
    return {
        name: getattr(found.gaussians, name)
        for name in ("means", "quats", "scales", "opacities", "sh")
    }


def test_it_learns_a_box(scene: Scene) -> None:
    heard = Heard()
    found = fit_gaussians(scene, config(steps=120, validate_every=120), listener=heard)
    first, *_, last = heard.of(StepReport)
    assert last.loss < 0.75 * first.loss
    (validation,) = heard.of(ValidationReport)
    assert {*validation.scores} == {"psnr", "foreground_psnr"}
    # Two views of six were held out; the background alone would give 12.
    assert validation.psnr > 17
    assert len(found.gaussians) == DENSITY.limit
    assert heard.of(PopulationReport)[-1].points == DENSITY.limit
    assert {*first.losses} == {"l1", "ssim"}
    cameras = [view.camera for view in hold_out(scene.split("train"), every=3)[0]]
    widths = [pixel_width(found.gaussians, camera) for camera in cameras]
    assert found.footprint.pixel == max(widths)
    # On the object's surface, not around it.
    solid = found.gaussians.opacities > 0.5
    assert float(found.gaussians.means[solid].abs().amax()) < 0.75


def test_flat_ones_learn_a_box_and_face_its_sides(scene: Scene) -> None:
    footprint = Footprint(flat=True)
    heard = Heard()
    settings = config(steps=200, validate_every=200, footprint=footprint)
    found = fit_gaussians(scene, settings, listener=heard)
    (validation,) = heard.of(ValidationReport)
    assert validation.psnr > 17
    assert replace(found.footprint, pixel=None) == footprint
    own = found.gaussians
    assert bool((own.scales[:, 2] < 0.1 * own.scales[:, :2].amin(dim=1)).all())


@pytest.mark.parametrize("until", [0.5, None])
def test_held_out_views_are_learned_from_when_they_no_longer_validate(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, until: float | None
) -> None:
    """Held-out photos that change move no step of the first part, and the result of the rest."""
    held = {view.image.path for view in hold_out(scene.split("train"), every=3)[1]}
    settings = config(held_out_until=until, density=replace(DENSITY, last=0.4))
    clean, painted = Heard(), Heard()
    first = fit_gaussians(scene, settings, listener=clean)
    original = pcore.data.images.read_rgba

    def read(path: Path, **options: Any) -> torch.Tensor:
        pixels = original(path, **options)
        return 1 - pixels if path in held else pixels

    monkeypatch.setattr(pcore.data.images, "read_rgba", read)
    second = fit_gaussians(load_scene(scene.root), settings, listener=painted)
    losses = [
        [one.loss for one in heard.of(StepReport) if one.step <= 40 * (until or 1)]
        for heard in (clean, painted)
    ]
    assert len(losses[0]) == (2 if until else 4)
    assert losses[0] == losses[1]
    assert torch.equal(first.gaussians.sh, second.gaussians.sh) == (until is None)
    steps = [one.step for one in clean.of(ValidationReport)]
    assert steps == ([20] if until else [20, 40])
    assert [one.learned_next for one in clean.of(ValidationReport)][-1] == bool(until)


def test_the_same_seed_gives_the_same_gaussians(scene: Scene) -> None:
    first, second = (fit_gaussians(scene, config()) for _ in range(2))
    assert_same(tensors(first), tensors(second))
    other = fit_gaussians(scene, config(seed=4))
    assert not torch.equal(first.gaussians.means[:50], other.gaussians.means[:50])


@pytest.mark.parametrize("more", [{}, {"exposure": "per-view", "levels": LEVELS}])
def test_an_interrupted_run_ends_as_one_that_was_not(
    scene: Scene, tmp_path: Path, more: dict[str, Any]
) -> None:
    whole = fit_gaussians(scene, config(**more))

    def folder(*, resume: bool) -> RunFolder:
        return RunFolder.create(
            tmp_path / "run", stage="pretrain", scene="box", config={}, resume=resume
        )

    def stop(event: Event) -> None:
        if isinstance(event, StepReport) and event.step == 20:
            signal.raise_signal(signal.SIGINT)

    with folder(resume=False) as run, pytest.raises(KeyboardInterrupt):
        fit_gaussians(scene, config(**more), folder=run, listener=stop)
    with folder(resume=True) as run:
        assert run.saved_step() == 20
        found = fit_gaussians(scene, config(**more), folder=run)
    assert_same(tensors(found), tensors(whole))
    saved = load_gaussians(tmp_path / "run")
    assert torch.equal(saved.gaussians.sh, whole.gaussians.sh)
    assert saved.footprint == whole.footprint
    assert (saved.provenance.step, saved.provenance.scene) == (40, "box")
    assert RunFolder.open(tmp_path / "run").notes["status"] == "finished"


def test_a_promise_is_kept_by_a_clock_and_across_processes(scene: Scene, tmp_path: Path) -> None:
    """Every reading of the clock takes its time: fewer steps fit than were foreseen."""
    seconds, now = 60.0, [0.0]

    def clock() -> float:
        now[0] += 0.5
        return now[0]

    settings = config(steps=2000, seconds=seconds, levels=LEVELS, points=40)
    heard = Heard()

    def stop(event: Event) -> None:
        heard(event)
        if isinstance(event, StepReport) and event.step == 30:
            signal.raise_signal(signal.SIGINT)

    def folder(*, resume: bool) -> RunFolder:
        return RunFolder.create(
            tmp_path / "run", stage="pretrain", scene="box", config={}, resume=resume
        )

    with folder(resume=False) as run, pytest.raises(KeyboardInterrupt):
        fit_gaussians(scene, settings, folder=run, listener=stop, clock=clock)
    before, now[0] = now[0], 1e6
    with folder(resume=True) as run:
        fit_gaussians(scene, settings, folder=run, listener=heard, clock=clock)
    assert before + now[0] - 1e6 == pytest.approx(seconds, rel=0.1)
    reports = heard.of(StepReport)
    assert reports[-1].step == reports[-1].steps < 400
    assert reports[-1].rates["scales"] < 0.1 * reports[0].rates["scales"]
    assert heard.of(ValidationReport)[0].step < 0.4 * reports[-1].step


def test_photos_of_changing_exposure_are_learned_with_a_map_for_each(tmp_path: Path) -> None:
    """Every second photo is half as bright: without maps the box is a colour between."""
    root = write_scene(tmp_path / "box", states=False)
    for path in sorted((root / "train").glob("*.png"))[::2]:
        picture = iio.imread(path)
        picture[..., :3] //= 2
        iio.imwrite(path, picture)
    figures: list[dict[str, float]] = []
    for exposure in (None, "per-view"):
        heard = Heard()
        settings = config(steps=120, validate_every=120, exposure=exposure)
        fit_gaussians(load_scene(root), settings, listener=heard)
        figures.append(heard.of(ValidationReport)[-1].scores)
        last = heard.of(StepReport)[-5:]
        figures[-1]["loss"] = sum(report.loss for report in last) / len(last)
    assert figures[1]["loss"] < 0.8 * figures[0]["loss"]
    assert {*figures[1]} - {*figures[0]} == {"fitted_psnr"}
    assert figures[1]["fitted_psnr"] > figures[1]["foreground_psnr"]


def test_units_do_not_matter(tmp_path: Path) -> None:
    """A world of other units trains to the same picture."""
    psnr: list[float] = []
    for name, factor in (("one", 1.0), ("small", 1e-3), ("large", 1e3)):
        root = write_scene(tmp_path / name, states=False)
        path = root / "transforms_train.json"
        content = json.loads(path.read_text())
        for frame in content["frames"]:
            for row in frame["transform_matrix"][:3]:
                row[3] *= factor
        path.write_text(json.dumps(content))
        heard = Heard()
        fit_gaussians(load_scene(root), config(), listener=heard)
        psnr.append(heard.of(ValidationReport)[-1].psnr)
    # Rounding differs, and training amplifies it.
    assert max(psnr) - min(psnr) < 1.0


def test_photos_without_masks_start_before_the_cameras(tmp_path: Path) -> None:
    root = write_scene(tmp_path / "box", states=False)
    for path in (root / "train").glob("*.png"):
        iio.imwrite(path, iio.imread(path)[..., :3])
    scene = load_scene(root)
    views, settings = scene.split("train"), config(start="views", points=3000)
    start = start_gaussians(scene, views, settings, torch.Generator().manual_seed(0))
    seen = torch.zeros(len(start), dtype=torch.bool)
    for view in views:
        column, row, depth = view.camera.project(start.means)
        inside = (column >= 0) & (column < view.camera.width) & (row >= 0)
        seen |= inside & (row < view.camera.height) & (depth > 0)
    assert seen.all()
    distance = camera_distance(scene)
    assert float(start.means.norm(dim=-1).amax()) > 5 * distance
    heard = Heard()
    fit_gaussians(scene, replace(settings, points=100), listener=heard)
    assert heard.of(StepReport)[-1].loss < heard.of(StepReport)[0].loss


def test_colours_begin_as_the_photos_show_them(scene: Scene) -> None:
    """The box has one colour; a point that no photo shows is grey."""
    positions = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 90.0]])
    found = mean_colors(positions, scene.split("train"))
    torch.testing.assert_close(found[0], torch.tensor([204, 102, 51]) / 255, atol=1e-3, rtol=0)
    assert torch.equal(found[1], torch.full((3,), 0.5))


def test_points_of_a_file_are_a_start(scene: Scene, tmp_path: Path) -> None:
    points = torch.rand(30, 3) - 0.5
    save_points(tmp_path / "points.npy", points)
    settings = config(start=str(tmp_path / "points.npy"))
    start = start_gaussians(scene, scene.split("train"), settings, torch.Generator())
    torch.testing.assert_close(start.means, points)


def test_a_state_of_another_kind_is_refused(scene: Scene, tmp_path: Path) -> None:
    with RunFolder.create(tmp_path / "run", stage="pretrain", scene="box", config={}) as run:
        run.save_state(box_work().state())
        with pytest.raises(CheckpointError, match="another kind of object"):
            fit_gaussians(scene, config(), folder=run)


def test_settings_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="steps >= 1"):
        config(steps=0)
    with pytest.raises(InputError, match="degree 0 to"):
        config(degree=9)
    with pytest.raises(InputError, match="opacity between 0 and 1"):
        config(opacity_start=1.0)
    with pytest.raises(InputError, match="expected one of tiny, fast"):
        gaussian_preset("paper")

"""Pre-training: it learns, looks at training views only, and is the same every time."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

import pcore.data.images
from pcore.capture.load import load_scene
from pcore.data.points import save_points
from pcore.data.scene import Scene, hold_out
from pcore.errors import InputError, SceneError, TrainingError
from pcore.files.run_folder import RunFolder
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig
from pcore.training import pretrain as module
from pcore.training.config import GrowConfig, PatchConfig, PretrainConfig, PruneConfig, Rates
from pcore.training.events import Event, PopulationReport, StepReport, ValidationReport
from pcore.training.pretrain import pretrain
from pcore.training.schedule import Level, Schedule
from pcore.training.trained import Trained
from small_training import Heard, assert_same, ctrl_c_at, pretrain_config, weights_of
from tiny_scene import write_scene

FROZEN = replace(pretrain_config(), steps=1)
"""One step, after which points stand almost where they started."""
LEARNER = PaprConfig(
    neighbours=6,
    octaves=Octaves.all(3),
    feature_size=8,
    key=MlpConfig(layers=2, width=16, size=16),
    query=MlpConfig(layers=2, width=16, size=16),
    value=MlpConfig(layers=2, width=16, size=8),
    unet_channels=(8, 12, 16),
    background_score=-2.0,
    cutoff=0.3,
)
QUICK = Rates(
    points=Schedule(base=2e-3),
    attention=Schedule(base=1e-2),
    features=Schedule(base=3e-2),
    influence=Schedule(base=5e-2),
    unet=Schedule(base=1e-2),
)


@pytest.mark.learned
def test_the_loss_decreases(box: Scene) -> None:
    heard = Heard()
    config = pretrain_config(
        model=LEARNER,
        rates=QUICK,
        steps=250,
        patch=PatchConfig(side=24),
        points=300,
        influence_start=2.0,
        opacity_weight=0.1,
        validate_every=20,
    )
    model = pretrain(box, config, listener=heard)
    losses = [event.loss for event in heard.of(StepReport)]
    # Over 8 seeds 0.16 to 0.42, and 1.2 to 9.9 dB.
    assert sum(losses[-3:]) < 0.7 * sum(losses[:3])
    validations = heard.of(ValidationReport)
    assert validations[-1].psnr > validations[0].psnr + 0.3
    assert validations[-1].views == 1
    assert (model.step, len(model.cloud)) == (250, 300)
    assert not any(parameter.requires_grad for parameter in model.papr.parameters())
    assert heard.of(StepReport)[0].losses.keys() == {"rgb", "opacity"}


# --- what it looks at -------------------------------------------------------------------------


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Files whose pixels are decoded from now on."""
    seen: list[Path] = []
    original = pcore.data.images.read_rgba

    def read(path: Path, **options: object) -> torch.Tensor:
        seen.append(path)
        return original(path, **options)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(pcore.data.images, "read_rgba", read)
    return seen


def test_test_views_are_never_looked_at(tmp_path: Path, decoded: list[Path]) -> None:
    folder = write_scene(tmp_path / "box", meshes=False, states=False)
    scene = load_scene(folder)
    for path in (folder / "test").iterdir():
        path.unlink()  # A look would be an error.
    heard = Heard()
    pretrain(scene, pretrain_config(steps=20), listener=heard)
    assert {path.parent.name for path in decoded} == {"train"}
    assert len({path.name for path in decoded}) == 6


def test_test_views_do_not_matter(tmp_path: Path) -> None:
    results: list[Trained] = []
    for name in ("clean", "poisoned"):
        folder = write_scene(tmp_path / name, meshes=False, states=False)
        if name == "poisoned":
            for path in (folder / "test").iterdir():
                Image.new("RGBA", (24, 24), "lime").save(path)
        results.append(pretrain(load_scene(folder), pretrain_config()))
    assert_same(weights_of(results[0]), weights_of(results[1]))


def test_held_out_views_only_validate(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A held-out view whose pixels change moves the validation and no weight."""
    _, (held,) = hold_out(box.split("train"), every=10)
    clean, poisoned = Heard(), Heard()
    first = pretrain(box, pretrain_config(), listener=clean)
    original = pcore.data.images.read_rgba

    def read(path: Path, **options: object) -> torch.Tensor:
        pixels = original(path, **options)  # pyright: ignore[reportArgumentType]
        return torch.zeros_like(pixels) if path == held.image.path else pixels

    monkeypatch.setattr(pcore.data.images, "read_rgba", read)
    second = pretrain(load_scene(box.root), pretrain_config(), listener=poisoned)
    assert_same(weights_of(first), weights_of(second))
    scores = [heard.of(ValidationReport)[-1].psnr for heard in (clean, poisoned)]
    assert abs(scores[0] - scores[1]) > 0.1


# --- randomness -------------------------------------------------------------------------------


def test_the_seed_decides_everything(box: Scene) -> None:
    config = pretrain_config(background="random")
    torch.manual_seed(1)
    first = pretrain(box, config)
    torch.manual_seed(2)
    second = pretrain(box, config)
    assert_same(weights_of(first), weights_of(second))
    other = weights_of(pretrain(box, replace(config, seed=4)))
    for name in ("positions", "features", "unet.inc.weight"):
        assert not torch.equal(other[name], weights_of(first)[name]), name


def test_the_global_generator_is_left_alone(box: Scene) -> None:
    state = torch.get_rng_state()
    pretrain(box, pretrain_config())
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    ("background", "expected"),
    [("white", (1, 1, 1)), ("black", (0, 0, 0)), ("random", (1, 1, 1))],
)
def test_the_background_goes_into_the_model(
    box: Scene, background: str, expected: tuple[float, ...]
) -> None:
    model = pretrain(box, replace(FROZEN, background=background))  # pyright: ignore
    assert model.papr.config.background == expected


# --- starting points --------------------------------------------------------------------------


def test_the_hull_encloses_the_object(box: Scene) -> None:
    points = pretrain(box, replace(FROZEN, points=400)).cloud.positions
    assert points.shape == (400, 3)
    half = torch.tensor([0.6, 0.45, 0.35])
    # Five views from one height leave much uncarved above and below, nothing missing.
    near = (points.abs() < half + torch.tensor([0.2, 0.2, 0.5])).all(dim=1)
    assert float(near.float().mean()) > 0.5
    assert bool((points[near].amax(dim=0) > 0.9 * half).all())
    assert bool((points[near].amin(dim=0) < -0.9 * half).all())
    assert not bool((points.abs() < 0.7 * half).all(dim=1).any())


def test_the_grid_of_the_original(box: Scene) -> None:
    points = pretrain(box, replace(FROZEN, start="grid", points=125)).cloud.positions
    # As large as that of a scene of the usual size (`Scene.radius` of NeRF-Synthetic).
    half = 1.2 * box.radius / 1.3654
    axis = torch.linspace(-half, half, 5)
    expected = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1).reshape(-1, 3)
    assert torch.allclose(points, expected, atol=5e-4)


@pytest.mark.parametrize("name", ["start.ply", "start.npy"])
def test_points_of_a_file(box: Scene, tmp_path: Path, name: str) -> None:
    start = 0.3 * torch.randn(33, 3)
    save_points(tmp_path / name, start)
    points = pretrain(box, replace(FROZEN, start=str(tmp_path / name))).cloud.positions
    assert points.shape == (33, 3)
    assert torch.allclose(points, start, atol=5e-4)


def test_influence_and_spread_of_features_at_the_start(box: Scene) -> None:
    config = replace(FROZEN, points=2000, influence_start=0.7, feature_spread=0.5)
    cloud = pretrain(box, config).cloud
    # One step of Adam changes nothing by more than its rate.
    assert torch.allclose(cloud.influence, torch.full((2000,), 0.7), atol=0.011)
    assert float(cloud.features.std()) == pytest.approx(0.5, abs=0.02)


def test_colours_start_the_same_from_every_side(box: Scene) -> None:
    model = replace(FROZEN.model, point_colors=True, color_degree=1, feature_size=16)
    cloud = pretrain(box, replace(FROZEN, points=500, model=model)).cloud
    sides, others = cloud.features[:, 3:12], cloud.features[:, 12:]
    # One step of Adam changes nothing by more than its rate, and what no ray met by nothing.
    assert 0 < float(sides.abs().max()) <= 0.011
    assert float(others.std()) == pytest.approx(1.0, abs=0.05)


def test_photos_without_alpha_have_no_hull(tmp_path: Path) -> None:
    folder = write_scene(tmp_path / "photos", meshes=False, states=False)
    for path in (folder / "train").iterdir():
        Image.open(path).convert("RGB").save(path)
    scene = load_scene(folder)
    message = r'photos: expected images with an alpha channel.*start from "grid" or from a PLY'
    with pytest.raises(InputError, match=message):
        pretrain(scene, FROZEN)
    assert len(pretrain(scene, replace(FROZEN, start="grid")).cloud) == 60


# --- population -------------------------------------------------------------------------------


def test_pruning_everything_is_an_error(box: Scene) -> None:
    config = pretrain_config(prune=PruneConfig(every=2, first=4, last=10, threshold=1e6))
    heard = Heard()
    with pytest.raises(
        TrainingError, match=r"pruning at step 4: no point has an influence above 1000000.0.*empty"
    ):
        pretrain(box, config, listener=heard)
    assert heard.of(PopulationReport) == []


def test_only_points_of_little_influence_go(box: Scene) -> None:
    config = pretrain_config(steps=4, points=100)
    kept = pretrain(box, config).cloud
    # Half of them, whatever was learned.
    threshold = float(kept.influence.median())
    prune = PruneConfig(every=1, first=4, last=4, threshold=threshold)
    heard = Heard()
    cloud = pretrain(box, replace(config, prune=prune), listener=heard).cloud
    assert torch.equal(cloud.influence, kept.influence[kept.influence > threshold])
    assert torch.equal(cloud.positions, kept.positions[kept.influence > threshold])
    (report,) = heard.of(PopulationReport)
    assert (report.step, report.grown, report.points) == (4, 0, len(cloud))
    assert report.pruned == 100 - len(cloud) > 0


def test_a_raised_threshold_waits_for_its_step(box: Scene) -> None:
    prune = PruneConfig(every=1, first=1, last=4, threshold=-9.0, raised=1.0, raise_after=3)
    config = pretrain_config(steps=4, prune=prune, points=100)
    heard = Heard()
    cloud = pretrain(box, config, listener=heard).cloud
    kept = pretrain(box, replace(config, prune=None)).cloud
    assert torch.equal(cloud.influence, kept.influence[kept.influence > 1.0])
    assert [report.step for report in heard.of(PopulationReport)] == [4]


def test_the_cloud_grows_up_to_its_limit(box: Scene) -> None:
    heard = Heard()
    grow = GrowConfig(every=2, first=3, last=11, count=20, limit=110)
    cloud = pretrain(box, pretrain_config(grow=grow), listener=heard).cloud
    reports = [(one.step, one.grown, one.points) for one in heard.of(PopulationReport)]
    assert reports == [(4, 20, 80), (6, 20, 100), (8, 10, 110)]
    assert cloud.positions.shape == (110, 3)
    assert cloud.features.shape == (110, 4)


def test_new_points_are_mixtures(box: Scene) -> None:
    grow = GrowConfig(every=4, first=4, last=4, count=15, limit=100)
    old = pretrain(box, pretrain_config(steps=4)).cloud
    new = pretrain(box, pretrain_config(steps=4, grow=grow)).cloud
    for name in ("positions", "features", "influence"):
        before, after = getattr(old, name), getattr(new, name)
        assert torch.equal(after[:60], before), name
        # Weights add up to one but for rounding.
        assert bool((after[60:].amax(dim=0) <= before.amax(dim=0) + 1e-5).all()), name
        assert bool((after[60:].amin(dim=0) >= before.amin(dim=0) - 1e-5).all()), name


def test_grown_points_are_trained(box: Scene) -> None:
    grow = GrowConfig(every=4, first=4, last=4, count=15, limit=100)
    early = pretrain(box, pretrain_config(steps=4, grow=grow)).cloud
    # A longer run has other rates: only that new points move is asked for.
    late = pretrain(box, pretrain_config(steps=12, grow=grow)).cloud
    assert len(early) == len(late) == 75
    assert float((late.features[60:] - early.features[60:]).abs().amax(dim=1).min()) > 0


# --- interruption -----------------------------------------------------------------------------


def in_folder(scene: Scene, config: PretrainConfig, path: Path, *, resume: bool) -> Trained:
    with RunFolder.create(path, stage="pretrain", scene="box", config={}, resume=resume) as folder:
        return pretrain(scene, config, folder=folder)


def test_resuming_after_the_population_changed_is_bitwise(
    box: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = pretrain_config(
        background="random",
        patch=PatchConfig(side=12, views=2),
        prune=PruneConfig(every=3, first=3, last=9, threshold=0.99),
        grow=GrowConfig(every=4, first=4, last=8, count=7, limit=90),
    )
    heard = Heard()
    expected = pretrain(box, config, listener=heard)
    assert sum(event.pruned for event in heard.of(PopulationReport)) > 0
    assert sum(event.grown for event in heard.of(PopulationReport)) == 14
    ctrl_c_at(monkeypatch, module, 2 * 7)
    with pytest.raises(KeyboardInterrupt, match="step 7 is saved"):
        in_folder(box, config, tmp_path / "run", resume=False)
    result = in_folder(box, config, tmp_path / "run", resume=True)
    assert_same(weights_of(result), weights_of(expected))


def test_a_truncated_held_out_image_is_found_before_the_first_step(tmp_path: Path) -> None:
    folder = write_scene(tmp_path / "box", meshes=False, states=False)
    scene = load_scene(folder)
    _, held_out = hold_out(scene.split("train"), every=10)
    photo = folder / "train" / f"{held_out[0].name}.png"
    photo.write_bytes(photo.read_bytes()[:-40])
    heard = Heard()
    with pytest.raises(SceneError, match=f"{held_out[0].name}.png"):
        pretrain(load_scene(folder), pretrain_config(), listener=heard)
    assert heard.of(StepReport) == []


def test_a_promise_with_exposure_from_coarse_to_fine_is_kept_across_processes(
    box: Scene, tmp_path: Path
) -> None:
    now = [0.0]

    def clock() -> float:
        now[0] += 0.5
        return now[0]

    heard = Heard()
    config = pretrain_config(
        steps=500, seconds=40.0, levels=(Level(until=0.4, reduction=2),), exposure="per-view"
    )

    def stop(event: Event) -> None:
        heard(event)
        if isinstance(event, StepReport) and event.step == 10:
            signal.raise_signal(signal.SIGINT)

    def folder(*, resume: bool) -> RunFolder:
        return RunFolder.create(
            tmp_path / "run", stage="pretrain", scene="box", config={}, resume=resume
        )

    with folder(resume=False) as run, pytest.raises(KeyboardInterrupt):
        pretrain(box, config, folder=run, listener=stop, clock=clock)
    with folder(resume=True) as run:
        pretrain(box, config, folder=run, listener=heard, clock=clock)
    assert now[0] == pytest.approx(40.0, rel=0.15)
    assert 10 < heard.of(StepReport)[-1].step < 100
    assert "fitted_psnr" in heard.of(ValidationReport)[-1].scores

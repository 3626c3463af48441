"""What `pcore check` says a training will take, against what it takes."""

import math
import time
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest
from torch import Tensor

from pcore.data.scene import Scene, View
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import GaussianPictures, PosedGaussians
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.render.image import Image
from pcore.training import forecast, gaussian_fit, measured_speed
from pcore.training import pretrain as pretraining
from pcore.training.config import GrowConfig, PatchConfig, PretrainConfig
from pcore.training.forecast import forecasts, gaussian_forecast, papr_forecast
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.measured_speed import StepCost, papr_step
from pcore.training.presets import gaussian_preset
from pcore.training.pretrain import pretrain
from pcore.training.speed import Speed
from small_training import pretrain_config
from tiny_scene import CONFIG

SAID = forecast.Forecast(
    model="papr", preset="tiny", seconds=1.0, within=1.0, memory=1.0, quality="", how=""
)


@dataclass
class Counted:
    """A clock that tells the work that was done, in which a busy machine changes nothing."""

    now: float = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    """Work of trainings and of the steps that foretell them: rays, or pixels and Gaussians."""
    clock = Counted()
    trace, draw = pretraining.training_image, gaussian_fit.render_views

    def traced(papr: Papr, posed: PosedCloud, rays: RayBundle, background: Tensor) -> Image:
        clock.now += math.prod(rays.shape)
        return trace(papr, posed, rays, background)

    def drawn(posed: PosedGaussians, *arguments: Any, **named: Any) -> GaussianPictures:
        width, height = arguments[2]
        clock.now += 1000.0 + width * height + 3.0 * len(posed.gaussians.means)
        return draw(posed, *arguments, **named)

    monkeypatch.setattr(pretraining, "training_image", traced)
    for module in (gaussian_fit, measured_speed):
        monkeypatch.setattr(module, "render_views", drawn)
    monkeypatch.setattr(forecast, "time", SimpleNamespace(process_time=clock))
    return clock


def few_gaussians(steps: int) -> GaussianConfig:
    return GaussianConfig(
        steps=steps,
        points=1500,
        density=DensityConfig(limit=1500),
        validate_every=steps,
        save_every=steps,
    )


def few_points(steps: int) -> PretrainConfig:
    return pretrain_config(
        model=replace(CONFIG, samples=4),
        steps=steps,
        patch=PatchConfig(side=24, samples=2),
        points=600,
        validate_every=steps,
        save_every=steps,
    )


def test_gaussians_do_the_work_that_was_said(box: Scene, counted: Counted) -> None:
    config = few_gaussians(60)
    speed = measured_speed.measured_speed(box, config, clock=counted)
    said = gaussian_forecast(box, config, speed).seconds
    assert said is not None
    counted.now = 0.0
    fit_gaussians(box, config)
    # Steps before the growth has ended have fewer Gaussians than were counted on.
    assert 0.7 * said < counted.now < said


@pytest.mark.parametrize("largest", [24, 16])
def test_papr_does_the_work_that_was_said(
    largest: int, box: Scene, counted: Counted, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcore.training.forecast._SMALL", largest)
    monkeypatch.setattr("pcore.training.forecast._PROBE", 16)
    said = papr_forecast(box, few_points(20))
    assert said.seconds is not None
    assert said.within == (1.3 if largest == 24 else 2.0)
    counted.now = 0.0
    pretrain(box, few_points(20))
    assert counted.now == pytest.approx(said.seconds / forecast._MORE)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["gaussians", "papr"])
def test_trainings_take_the_time_that_was_said(model: str, box: Scene) -> None:
    if model == "gaussians":
        config = few_gaussians(800)
        speed = measured_speed.measured_speed(box, config, clock=time.process_time)
        said = gaussian_forecast(box, config, speed).seconds
    else:
        said = papr_forecast(box, few_points(800)).seconds
    assert said is not None
    began = time.process_time()
    if model == "gaussians":
        fit_gaussians(box, few_gaussians(800))
    else:
        pretrain(box, few_points(800))
    assert said / 2 < time.process_time() - began < 2 * said


def test_points_that_spread_take_longer(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a grid few rays meet points, in the end all do: the mean of both, and a wider bound."""
    seconds = {True: 1.0, False: 3.0}

    def step(scene: Scene, config: PretrainConfig, *_: object) -> StepCost:
        return StepCost(seconds=seconds[config.model.cutoff is not None], memory=2.0)

    monkeypatch.setattr(measured_speed, "_timed_step", step)
    config = pretrain_config(model=replace(CONFIG, cutoff=0.1), steps=100)
    hull, grid = (papr_forecast(box, replace(config, start=start)) for start in ("hull", "grid"))
    assert hull.seconds is not None
    assert grid.seconds == pytest.approx(2 * hull.seconds)
    assert (hull.within, grid.within) == (1.3, 2.0)
    # What `pcore train` says and plans by.
    assert papr_step(box, replace(config, start="grid")).seconds == 2.0


def test_steps_are_timed_with_decoded_photos_from_one_start(
    box: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    rgba, begin = View.rgba, measured_speed.start_gaussians

    def decoded(view: View) -> Tensor:
        done.append(view.name)
        return rgba(view)

    def started(*arguments: Any) -> Gaussians:
        done.append("start")
        return begin(*arguments)

    def clock() -> float:
        done.append("clock")
        return time.process_time()

    monkeypatch.setattr(View, "rgba", decoded)
    monkeypatch.setattr(measured_speed, "start_gaussians", started)
    shown = {view.name for view in measured_speed._some(box.split("train"))}
    papr_step(box, pretrain_config(), clock=clock)
    assert shown <= {*done[: done.index("clock")]}
    done.clear()
    speed = measured_speed.measured_speed(box, gaussian_preset("tiny"), clock=clock)
    assert shown <= {*done[: done.index("clock")]}
    assert done.count("start") == 1
    assert speed.gaussian > 1e-8


def test_what_gradients_keep_grows_with_the_rays(box: Scene) -> None:
    small, large = (
        papr_step(box, pretrain_config(patch=PatchConfig(side=side))).memory for side in (8, 16)
    )
    assert 2 < large / small < 5


def test_lpips_and_the_points_to_come_are_counted(box: Scene) -> None:
    plain = pretrain_config()
    with_lpips = papr_forecast(box, replace(plain, lpips_weight=0.01))
    more_points = papr_forecast(box, replace(plain, grow=GrowConfig(limit=4000)))
    bare = papr_forecast(box, plain)
    assert bare.seconds is not None
    assert with_lpips.seconds is not None
    assert more_points.memory is not None
    assert bare.memory is not None
    assert with_lpips.seconds > 2 * bare.seconds
    assert more_points.memory > bare.memory


def test_of_few_photos_no_quality_is_promised(box: Scene) -> None:
    count = len(box.split("train"))
    assert count < 20
    for masked in (True, False):
        said = forecast._quality("gaussians", box, masked=masked)
        assert said == f"not recorded of so few photos ({count})"


def test_every_preset_has_a_forecast(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcore.training.forecast._FEWEST", 1)
    monkeypatch.setattr("pcore.training.forecast._PROBE", 8)
    found = {(one.model, one.preset): one for one in forecasts(box)}
    assert set(found) == {
        ("gaussians", "tiny"),
        ("gaussians", "fast"),
        ("papr", "tiny"),
        ("papr", "fast"),
        ("papr", "paper"),
    }
    days = [found["papr", name].seconds or 0 for name in ("tiny", "fast", "paper")]
    assert 0 < days[0] < days[1] < days[2]
    assert all(one.memory is not None and one.memory > 0.5e9 for one in found.values())
    assert found["papr", "tiny"].quality.startswith("23 to 32 dB of the object")
    assert found["papr", "tiny"].quality.endswith(
        "photos of a house of 200 x 150 pixels had 14 to 17"
    )
    assert found["papr", "paper"].quality == "not recorded"
    said = forecast._quality("papr", box, masked=False)
    assert said.startswith("7 to 13 dB with the background")
    assert "take Gaussians" in said


def test_the_speed_of_gaussians_is_measured_once(
    box: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Presets may differ in what `measured_speed` sets itself or does not read, in nothing else."""
    tiny, fast = gaussian_preset("tiny"), gaussian_preset("fast")
    alike = {
        name: getattr(tiny, name)
        for name in ("steps", "points", "rates", "density", "validate_every", "save_every")
    }
    assert replace(fast, **alike) == tiny
    calls: list[Scene] = []

    def measured(scene: Scene, *_: object, **__: object) -> Speed:
        calls.append(scene)
        return Speed()

    monkeypatch.setattr(forecast, "measured_speed", measured)
    monkeypatch.setattr(forecast, "papr_forecast", lambda scene, config: SAID)
    assert len(forecasts(box)) == 5
    assert calls == [box]


def test_larger_photos_are_told_which_factor_has_the_recorded_size(
    box: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcore.training.forecast._FEWEST", 1)
    small = replace(forecast._RECORDS[0], side=12)
    monkeypatch.setattr("pcore.training.forecast._RECORDS", (small,))
    said = forecast._quality("gaussians", replace(box, factor=3), masked=True)
    assert said.startswith("less than 29 to 37 dB")
    assert said.endswith("--factor 6 is about that size")

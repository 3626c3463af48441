"""Named settings: sizes and schedule of the original, and what asks for LPIPS weights."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import get_args

import pytest

from pcore.errors import InputError
from pcore.files.records import from_dict, to_dict
from pcore.model.papr_config import Octaves
from pcore.training.config import FinetuneConfig, PresetName, PretrainConfig
from pcore.training.presets import demo_finetune, demo_pretrain, finetune_preset, preset

NAMES = get_args(PresetName)


def test_names() -> None:
    assert NAMES == ("tiny", "fast", "paper")
    assert len({preset(name) for name in NAMES}) == 3


@pytest.mark.parametrize("make", [preset, finetune_preset])
def test_an_unknown_name(make: object) -> None:
    assert callable(make)
    with pytest.raises(InputError, match=r"one of tiny, fast, paper(, paper-lego)?, got 'papper'"):
        make("papper")


def test_paper_is_the_model_of_the_original() -> None:
    model = preset("paper").model
    assert (model.neighbours, model.coord_scale, model.octaves) == (20, 10.0, Octaves.all(6))
    assert (model.feature_size, model.background_score, model.cutoff) == (64, 5.0, None)
    shapes = [(net.layers, net.width, net.size) for net in (model.key, model.query, model.value)]
    assert shapes == [(5, 256, 256), (5, 256, 256), (8, 256, 32)]
    assert model.unet_channels == (128, 256, 512)
    assert model.negative_slope == 0.0
    assert all(net.skip_after is None for net in (model.key, model.query, model.value))


def test_paper_trains_as_the_original() -> None:
    config = preset("paper")
    assert (config.steps, config.patch.side, config.patch.views) == (250_000, 160, 1)
    assert (config.lpips_weight, config.lpips_trunk) == (0.01, "vgg")
    assert (config.points, config.influence_start, config.feature_spread) == (3000, 0.0, 1.0)
    assert (config.opacity_weight, config.mixed_precision) == (0.0, True)
    prune, grow = config.prune, config.grow
    assert prune is not None
    assert grow is not None
    assert (prune.every, prune.first, prune.last, prune.threshold) == (500, 10_000, 150_000, 0.0)
    assert (grow.every, grow.first, grow.last) == (1000, 20_000, 70_000)
    assert (grow.count, grow.limit) == (1000, 30_000)


def test_lego_differs_from_the_other_scenes_of_the_original() -> None:
    paper, lego = preset("paper"), preset("paper-lego")
    model = lego.model
    assert (model.negative_slope, model.background_score, model.value.skip_after) == (0.2, 3.0, 5)
    assert lego.rates.points.at(0, lego.steps) == 3e-3
    assert lego.prune is not None
    steps = (10_000, 40_000, 40_500, 150_000)
    assert [lego.prune.threshold_at(step) for step in steps] == [0.0, 0.0, 0.2, 0.2]
    same = replace(lego, model=paper.model, rates=paper.rates, prune=paper.prune)
    assert same == paper
    assert replace(lego.rates, points=paper.rates.points) == paper.rates
    assert from_dict(PretrainConfig, to_dict(lego), where="run.json") == lego


def test_rates_of_the_original() -> None:
    rates, steps = preset("paper").rates.named(), 250_000
    bases = {"attention": 3e-4, "features": 1e-3, "influence": 1e-3, "unet": 1e-4}
    assert rates["points"].at(0, steps) == 2e-3
    assert rates["points"].at(steps // 2, steps) == pytest.approx(1e-3)
    assert rates["points"].at(steps - 1, steps) == pytest.approx(0, abs=1e-9)
    for name, base in bases.items():
        assert rates[name].at(0, steps) == pytest.approx(base / 10_000), name
        assert rates[name].at(10_000, steps) == pytest.approx(base), name
        assert rates[name].at(steps, steps) == pytest.approx(base / 2), name


def test_the_cosine_of_the_original_is_twice_as_long_as_the_training() -> None:
    schedule, steps = preset("paper").rates.attention, 250_000
    # Half of the way after the warm-up: (1 + cos(pi / 4)) / 2 of the base.
    assert schedule.at(130_000, steps) == pytest.approx(3e-4 * 0.853553, rel=1e-4)


@pytest.mark.parametrize("name", ["tiny", "fast"])
def test_small_presets_ask_for_no_weights(name: PresetName) -> None:
    assert preset(name).lpips_weight == 0
    assert finetune_preset(name).lpips_weight == 0


def test_paper_fine_tunes_for_500_steps_with_lpips() -> None:
    config = finetune_preset("paper")
    assert (config.steps, config.lpips_weight) == (500, 0.01)
    assert config.points_only
    assert config.rays_and_points


def test_tiny_fits_two_cores() -> None:
    config = preset("tiny")
    assert config.model.neighbours * config.model.key.width <= 8 * 64
    assert config.model.cutoff is not None
    assert config.points <= 10_000
    assert not config.mixed_precision
    assert not finetune_preset("tiny").mixed_precision


def test_the_demo_is_tiny_and_shorter() -> None:
    assert demo_pretrain().model == preset("tiny").model
    assert demo_pretrain().patch == preset("tiny").patch
    assert demo_finetune().patch == finetune_preset("tiny").patch
    assert demo_pretrain().steps < preset("tiny").steps
    assert demo_finetune().steps < finetune_preset("tiny").steps


@pytest.mark.parametrize("name", NAMES)
def test_every_rate_is_positive_from_the_first_step_on(name: PresetName) -> None:
    for config in (preset(name), finetune_preset(name)):
        for group, schedule in config.rates.named().items():
            rates = [schedule.at(step, config.steps) for step in (0, 1, config.steps // 2)]
            assert min(rates) > 0, group


@pytest.mark.parametrize("name", NAMES)
def test_settings_survive_the_record_of_a_run(name: PresetName) -> None:
    for kind, config in (
        (PretrainConfig, preset(name)),
        (FinetuneConfig, finetune_preset(name)),
    ):
        assert from_dict(kind, to_dict(config), where="run.json") == config


@pytest.mark.parametrize("value", [-0.5, float("nan"), float("inf")])
@pytest.mark.parametrize("make", [preset, finetune_preset])
def test_weights_of_losses_are_finite_and_not_negative(make: object, value: float) -> None:
    assert callable(make)
    config = make("tiny")
    names = [one.name for one in fields(config) if one.name.endswith("_weight")]
    assert {"lpips_weight", "opacity_weight", "front_weight"} <= {*names}
    for name in names:
        with pytest.raises(InputError, match=f"expected {name} to be a finite number of 0 or more"):
            replace(config, **{name: value})

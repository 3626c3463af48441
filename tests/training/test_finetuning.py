"""Fine-tuning: the base stays, the surface learns to follow, options do what they say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import pcore.data.images
from pcore.capture.load import load_scene
from pcore.data.scene import Scene, hold_out
from pcore.deform.sampler import DeformationRanges
from pcore.errors import InputError
from pcore.files.model_file import load_model
from pcore.files.run_folder import RunFolder
from pcore.model.papr import Papr
from pcore.training import finetune as module
from pcore.training import loop, objective, trainable
from pcore.training.config import FinetuneConfig, PatchConfig, Rates
from pcore.training.events import BudgetReport, StepReport, Stopped, ValidationReport
from pcore.training.finetune import finetune
from pcore.training.schedule import Schedule
from pcore.training.trained import Trained
from small_training import (
    RATES,
    ZERO,
    Heard,
    assert_same,
    box_model,
    copied,
    ctrl_c_at,
    finetune_config,
    weights_of,
)
from tiny_scene import write_scene


def every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Report every step."""
    monkeypatch.setattr(loop, "_REPORT_EVERY", 1)


# --- what it does -----------------------------------------------------------------------------


def test_the_base_is_left_as_it_is(box: Scene) -> None:
    base = box_model()
    before = copied(weights_of(base))
    tuned = finetune(box, base, finetune_config())
    assert_same(weights_of(base), before)
    assert not any(parameter.requires_grad for parameter in base.papr.parameters())
    after = weights_of(tuned)
    # Adam moves what has a gradient by about its rate in the very first step.
    for name in ("influence", "features", "attention.w_key.weight", "unet.outc.weight"):
        assert float((after[name] - before[name]).abs().max()) > 1e-4, name
    assert tuned.step == 6


def test_points_stay_where_they_are(box: Scene) -> None:
    base = box_model()
    tuned = finetune(box, base, finetune_config())
    assert torch.equal(tuned.cloud.positions, base.cloud.positions)


def opaque_model() -> Trained:
    """Random networks whose points hide the background."""
    base = box_model(150)
    papr = Papr(replace(base.papr.config, cutoff=0.3, background_score=1.0))
    papr.load_state_dict(base.papr.state_dict())
    return replace(base, papr=papr.requires_grad_(False))


@pytest.mark.learned
def test_the_surface_learns_to_follow(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """L_geo over the same draws, before and after fine-tuning with others."""
    every_step(monkeypatch)
    frozen = Rates(**dict.fromkeys(RATES.named(), ZERO))
    quick = replace(frozen, attention=Schedule(base=3e-3), influence=Schedule(base=1e-2))
    settings = finetune_config(
        steps=40,
        rates=quick,
        patch=PatchConfig(side=24),
        geometry_weight=100.0,
        texture_weight=0.0,
        validate_every=99,
    )

    def measure(model: Trained) -> float:
        heard = Heard()
        finetune(box, model, replace(settings, rates=frozen, seed=77, steps=16), listener=heard)
        reports = heard.of(StepReport)
        return sum(one.losses["geo_points"] + one.losses["geo_rays"] for one in reports)

    before = measure(opaque_model())
    after = measure(finetune(box, opaque_model(), settings))
    # Over 6 seeds 0.58 to 0.59.
    assert 0 < after < 0.8 * before


def test_aware_rays_leave_nothing_of_affine_deformations(
    box: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Uniform scales and rays that are scaled along: the geometry loss is rounding alone."""
    every_step(monkeypatch)
    ranges = DeformationRanges(scale_share=1.0)
    geometry: dict[bool, float] = {}
    for aware in (False, True):
        heard = Heard()
        config = finetune_config(
            aware=aware, ranges=ranges, points_only=False, steps=1, origin_distance=1.0
        )
        finetune(box, box_model(), config, listener=heard)
        geometry[aware] = heard.of(StepReport)[0].losses["geo_rays"]
    assert geometry[True] < 1e-6
    assert geometry[False] > 100 * geometry[True]


def test_only_training_views_are_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(write_scene(tmp_path / "box", meshes=False, states=False))
    for path in (tmp_path / "box" / "test").iterdir():
        path.unlink()
    seen: list[str] = []
    original = pcore.data.images.read_rgba

    def read(path: Path, **options: object) -> torch.Tensor:
        seen.append(path.parent.name)
        return original(path, **options)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(pcore.data.images, "read_rgba", read)
    heard = Heard()
    finetune(scene, box_model(), finetune_config(), listener=heard)
    assert set(seen) == {"train"}
    assert [one.step for one in heard.of(ValidationReport)] == [3, 6]


def test_the_seed_decides_everything(box: Scene) -> None:
    config = finetune_config(background="random")
    torch.manual_seed(1)
    first = finetune(box, box_model(), config)
    torch.manual_seed(2)
    second = finetune(box, box_model(), config)
    assert_same(weights_of(first), weights_of(second))
    other = finetune(box, box_model(), replace(config, seed=1))
    assert not torch.equal(other.cloud.influence, first.cloud.influence)


# --- options ----------------------------------------------------------------------------------

POINTS, RAYS = {"geo_points", "tex_points"}, {"geo_rays", "tex_rays"}


def terms(
    scene: Scene, config: FinetuneConfig, monkeypatch: pytest.MonkeyPatch
) -> list[dict[str, float]]:
    every_step(monkeypatch)
    heard = Heard()
    finetune(scene, box_model(), config, listener=heard)
    return [dict(one.losses) for one in heard.of(StepReport)]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, [POINTS | RAYS] * 4),
        ({"rays_and_points": False}, [POINTS] * 4),
        ({"points_only": False}, [RAYS] * 4),
        ({"alternate": True}, [POINTS, RAYS, POINTS, RAYS]),
        ({"alternate": True, "points_only": False}, [RAYS] * 4),
        ({"alternate": True, "rays_and_points": False}, [POINTS] * 4),
    ],
)
def test_modes(
    box: Scene,
    changes: dict[str, bool],
    expected: list[set[str]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = terms(box, finetune_config(steps=4, **changes), monkeypatch)
    assert [set(one) - {"rgb"} for one in found] == expected
    assert all("rgb" in one for one in found)


def test_weights_multiply_their_terms(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, weighted = (
        terms(box, finetune_config(steps=1, **weights), monkeypatch)[0]
        for weights in ({}, {"geometry_weight": 10.0, "texture_weight": 0.25})
    )
    assert weighted["rgb"] == plain["rgb"]
    for mode in ("points", "rays"):
        assert weighted[f"geo_{mode}"] == pytest.approx(10 * plain[f"geo_{mode}"])
        assert weighted[f"tex_{mode}"] == pytest.approx(0.25 * plain[f"tex_{mode}"])
        assert plain[f"tex_{mode}"] > 0


def test_the_opacity_loss_is_optional(box: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    found = terms(box, finetune_config(steps=1, opacity_weight=0.5), monkeypatch)
    assert found[0]["opacity"] > 0


@pytest.mark.parametrize("target", ["photo", "rendering"])
def test_the_texture_target(box: Scene, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under the identity a rendering agrees with itself and not with the photo."""
    from pcore.deform.base import Identity

    monkeypatch.setattr(objective, "sample_deformation", lambda *args: Identity())
    config = finetune_config(steps=1, texture_target=target, origin_distance=1.0)
    found = terms(box, config, monkeypatch)[0]
    expected = found["rgb"] if target == "photo" else 0.0
    assert found["tex_points"] == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert found["tex_rays"] == pytest.approx(expected, rel=1e-3, abs=1e-9)


def test_one_mode_at_least() -> None:
    with pytest.raises(InputError, match="at least one of points_only and rays_and_points"):
        finetune_config(points_only=False, rays_and_points=False)


@pytest.mark.parametrize("distance", [0.0, 1.5])
def test_origins_lie_between_surface_and_camera(distance: float) -> None:
    with pytest.raises(InputError, match=r"origin_distance above 0 and at most 1, got"):
        finetune_config(origin_distance=distance)


# --- canonical quality ------------------------------------------------------------------------


@pytest.fixture
def falling(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Trained]]:
    """Let validations find these PSNRs (the first is that of the base)."""

    def script(*psnrs: float) -> list[Trained]:
        rest, seen = list(psnrs), list[Trained]()

        def validate(model: Trained, *others: object, fitted: bool = False) -> dict[str, float]:
            seen.append(model)
            return {"psnr": rest.pop(0)}

        monkeypatch.setattr(module, "validate", validate)
        monkeypatch.setattr(trainable, "validate", validate)
        return seen

    return script


HARD: dict[str, object] = {"geometry_weight": 1e4}
"""What costs the learned box a tenth of a dB within six steps."""


@pytest.fixture(scope="module")
def learned(box_folder: Path) -> Trained:
    """A model that knows the box a little."""
    config = finetune_config(steps=40, validate_every=99)
    return finetune(load_scene(box_folder), box_model(), config)


def psnr_of(model: Trained, scene: Scene) -> float:
    _, views = hold_out(scene.split("train"), every=10)
    return trainable.validate(model, views, "white")["psnr"]


@pytest.mark.parametrize("largest_loss", [0.0, 0.02])
def test_the_result_meets_the_budget_with_a_part_of_the_change(
    box: Scene, learned: Trained, largest_loss: float
) -> None:
    heard = Heard()
    config = finetune_config(largest_loss=largest_loss, **HARD)
    tuned = finetune(box, learned, config, listener=heard)
    (told,) = heard.of(BudgetReport)
    assert 0.1 < told.share < 1
    assert told.before == psnr_of(learned, box)
    assert told.psnr == psnr_of(tuned, box) >= told.before - largest_loss > told.after
    whole = finetune(box, learned, replace(config, largest_loss=None))
    assert told.after == psnr_of(whole, box)
    before, after = weights_of(learned), weights_of(whole)
    for name, tensor in weights_of(tuned).items():
        assert torch.equal(tensor, before[name].lerp(after[name], told.share)), name
    assert_same(weights_of(finetune(box, learned, config)), weights_of(tuned))


def test_a_budget_that_is_met_changes_nothing(box: Scene, learned: Trained) -> None:
    heard = Heard()
    config = finetune_config(largest_loss=0.5, **HARD)
    tuned = finetune(box, learned, config, listener=heard)
    assert_same(
        weights_of(tuned), weights_of(finetune(box, learned, replace(config, largest_loss=None)))
    )
    (told,) = heard.of(BudgetReport)
    assert (told.share, told.psnr, told.largest_loss) == (1.0, told.after, 0.5)


def test_a_budget_that_nothing_meets_gives_the_base_back(
    box: Scene, falling: Callable[..., list[Trained]]
) -> None:
    falling(30.0, *[20.0] * 8)
    base = box_model()
    config, heard = finetune_config(steps=2, validate_every=2, largest_loss=0.5), Heard()
    tuned = finetune(box, base, config, listener=heard)
    assert_same(weights_of(tuned), weights_of(base))
    assert [one.accepted for one in heard.of(ValidationReport)] == [False]
    assert [one.share for one in heard.of(BudgetReport)] == [0.0]
    assert "no part of the change" in heard.of(Stopped)[0].message


def test_the_run_says_what_was_traded(
    box: Scene, falling: Callable[..., list[Trained]], tmp_path: Path
) -> None:
    """After one half all halves are refused."""
    falling(30.0, 29.8, 20.0, 29.6, *[20.0] * 6)
    config, heard = finetune_config(steps=4, validate_every=2, largest_loss=0.5), Heard()
    with RunFolder.create(
        tmp_path / "run", stage="finetune", scene="box", config={}, resume=False
    ) as folder:
        finetune(box, box_model(), config, folder=folder, listener=heard)
    assert [one.accepted for one in heard.of(ValidationReport)] == [True, False]
    assert heard.of(Stopped)[0].message == ""
    notes = RunFolder.open(tmp_path / "run").notes
    assert (notes["validation"]["kept_step"], notes["validation"]["kept_psnr"]) == (4, 29.6)
    expected = {"share": 0.5, "before": 30.0, "after": 20.0, "psnr": 29.6, "largest_loss": 0.5}
    assert notes["trade"] == expected
    assert load_model(tmp_path / "run").provenance.step == 4


def test_a_stopped_run_has_the_weights_that_met_the_budget_last(
    box: Scene,
    falling: Callable[..., list[Trained]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seen = falling(30.0, 29.8, 20.0)
    config = finetune_config(steps=6, validate_every=2, largest_loss=0.5)
    ctrl_c_at(monkeypatch, objective, 5)
    with pytest.raises(KeyboardInterrupt, match="step 5 is saved"):
        in_folder(box, config, tmp_path / "run", resume=False)
    saved = load_model(tmp_path / "run")
    assert saved.provenance.step == 2
    assert torch.equal(saved.cloud.influence, seen[1].cloud.influence)
    assert "trade" not in RunFolder.open(tmp_path / "run").notes


def test_no_limit_no_stop(box: Scene, falling: Callable[..., list[Trained]]) -> None:
    falling(20.0, 10.0)  # The base is not validated then.
    assert finetune(box, box_model(), finetune_config(largest_loss=None)).step == 6


def test_too_few_views_to_hold_one_out(box: Scene) -> None:
    config = finetune_config(largest_loss=0.5, hold_out=100)
    heard = Heard()
    assert finetune(box, box_model(), config, listener=heard).step == 6
    assert heard.of(ValidationReport) == []


# --- interruption -----------------------------------------------------------------------------


def in_folder(
    scene: Scene,
    config: FinetuneConfig,
    path: Path,
    *,
    resume: bool,
    base: Trained | None = None,
) -> Trained:
    with RunFolder.create(path, stage="finetune", scene="box", config={}, resume=resume) as folder:
        return finetune(scene, base or box_model(), config, folder=folder)


@pytest.mark.parametrize(
    "changes",
    [
        {"alternate": True, "background": "random"},
        {"largest_loss": 50.0},
    ],
)
@pytest.mark.parametrize("step", [1, 5])
def test_resuming_is_bitwise(
    box: Scene,
    tmp_path: Path,
    changes: dict[str, object],
    step: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = finetune_config(**changes)
    expected = finetune(box, box_model(), config)
    ctrl_c_at(monkeypatch, objective, step)
    with pytest.raises(KeyboardInterrupt, match=f"step {step} is saved"):
        in_folder(box, config, tmp_path / "run", resume=False)
    result = in_folder(box, config, tmp_path / "run", resume=True)
    assert_same(weights_of(result), weights_of(expected))
    saved = load_model(tmp_path / "run")
    assert saved.provenance.stage == "finetune"
    assert torch.equal(saved.cloud.influence, expected.cloud.influence)


@pytest.mark.parametrize("step", [1, 5])
def test_resuming_a_run_whose_budget_binds_is_bitwise(
    box: Scene, learned: Trained, tmp_path: Path, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, path = finetune_config(largest_loss=0.02, **HARD), tmp_path / "run"
    expected = finetune(box, learned, config)
    ctrl_c_at(monkeypatch, objective, step)
    with pytest.raises(KeyboardInterrupt, match=f"step {step} is saved"):
        in_folder(box, config, path, resume=False, base=learned)
    result = in_folder(box, config, path, resume=True, base=learned)
    assert_same(weights_of(result), weights_of(expected))
    # Killed between the state and the model of the last save: the state knows what was traded.
    traded = RunFolder.open(path).notes["trade"]
    assert 0 < traded["share"] < 1
    RunFolder.open(path).model.unlink()
    RunFolder.open(path).update(trade=None)
    again = in_folder(box, config, path, resume=True, base=learned)
    assert_same(weights_of(again), weights_of(expected))
    assert torch.equal(load_model(path).cloud.influence, expected.cloud.influence)
    assert RunFolder.open(path).notes["trade"] == traded

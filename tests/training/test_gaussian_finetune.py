"""P-CORE on Gaussians: what its losses see, its budget, resuming, one door for both objects."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

import pcore
from pcore.asset.training import RunOptions
from pcore.capture.load import load_scene
from pcore.cli.main import main
from pcore.data.scene import Scene
from pcore.deform.base import Affine, Identity
from pcore.deform.simple import uniform_scale
from pcore.errors import InputError
from pcore.evaluation.methods import label_of
from pcore.files.gaussian_file import load_gaussians
from pcore.files.run_folder import RunFolder
from pcore.gaussians.gaussian_rays import Traced, trace
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.training.events import BudgetReport, Event, StepReport
from pcore.training.gaussian_config import DensityConfig, GaussianConfig, GaussianFinetuneConfig
from pcore.training.gaussian_consistency import (
    Seen,
    carried_by,
    carried_pixels,
    consistency,
    deformed_rays,
    needles,
)
from pcore.training.gaussian_finetune import finetune_gaussians
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.trainable_gaussians import TrainedGaussians
from small_training import Heard, assert_same
from tiny_scene import write_scene

START = GaussianConfig(
    steps=40,
    points=100,
    density=DensityConfig(every=10, first=10, limit=150),
    hold_out=3,
    validate_every=40,
)
EYE = torch.tensor([4.0, 0.0, 0.0])


def config(**changes: Any) -> GaussianFinetuneConfig:
    settings: dict[str, Any] = {
        "steps": 12,
        "rays": 40,
        "hold_out": 3,
        "validate_every": 6,
        "save_every": 5,
        "seed": 1,
        "spread_weight": 1.0,
    }
    return GaussianFinetuneConfig(**{**settings, **changes})


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return load_scene(write_scene(tmp_path / "box", states=False))


@pytest.fixture
def base(scene: Scene) -> TrainedGaussians:
    return fit_gaussians(scene, START)


def tensors(found: TrainedGaussians) -> dict[str, torch.Tensor]:
    return dict(vars(found.gaussians))


def test_it_keeps_the_number_the_budget_and_what_it_began_with(
    scene: Scene, base: TrainedGaussians
) -> None:
    before = {name: tensor.clone() for name, tensor in tensors(base).items()}
    heard = Heard()
    found = finetune_gaussians(scene, base, config(largest_loss=0.0), listener=heard)
    assert_same(tensors(base), before)
    assert len(found.gaussians) == len(base.gaussians)
    assert found.stage == "finetune"
    names = {name for step in heard.of(StepReport) for name in step.losses}
    assert {"l1", "ssim", "spread"} < names
    assert any(name.startswith("geo_") for name in names)
    (budget,) = heard.of(BudgetReport)
    assert budget.psnr >= budget.before
    assert_same(tensors(finetune_gaussians(scene, base, config(largest_loss=0.0))), tensors(found))


def test_both_modes_take_turns_unless_one_is_left_out(scene: Scene, base: TrainedGaussians) -> None:
    for changes, expected in (
        ({"points_only": False}, {"tex_rays"}),
        ({"rays_and_points": False}, {"tex_points"}),
        ({"texture_weight": 0.0, "geometry_weight": 0.0, "spread_weight": 0.0}, set[str]()),
    ):
        heard = Heard()
        settings = config(steps=2, validate_every=10, largest_loss=None, **changes)
        finetune_gaussians(scene, base, settings, listener=heard)
        (report,) = heard.of(StepReport)
        assert {name for name in report.losses if name.startswith("tex")} == expected


def test_an_interrupted_run_ends_as_one_that_was_not(
    scene: Scene, base: TrainedGaussians, tmp_path: Path
) -> None:
    whole = finetune_gaussians(scene, base, config())

    def stop(event: Event) -> None:
        if isinstance(event, StepReport) and event.step == 10:
            signal.raise_signal(signal.SIGINT)

    def folder(*, resume: bool) -> RunFolder:
        return RunFolder.create(
            tmp_path / "run", stage="finetune", scene="box", config={}, resume=resume
        )

    with folder(resume=False) as run, pytest.raises(KeyboardInterrupt):
        finetune_gaussians(scene, base, config(), folder=run, listener=stop)
    with folder(resume=True) as run:
        found = finetune_gaussians(scene, base, config(), folder=run)
    assert_same(tensors(found), tensors(whole))
    saved = load_gaussians(tmp_path / "run")
    assert torch.equal(saved.gaussians.sh, whole.gaussians.sh)
    assert saved.provenance.stage == "finetune"


def plate(color: float = 0.9, thickness: float = 1e-4) -> Gaussians:
    """A sheet of Gaussians across x, seen from `EYE`."""
    y, z = torch.meshgrid(torch.linspace(-0.3, 0.3, 7), torch.linspace(-0.3, 0.3, 7), indexing="ij")
    count = y.numel()
    return Gaussians(
        means=torch.stack([torch.zeros(count), y.flatten(), z.flatten()], dim=-1),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(count, 4),
        scales=torch.tensor([thickness, 0.1, 0.1]).expand(count, 3),
        opacities=torch.full((count,), 0.9),
        sh=torch.full((count, 1, 3), (color - 0.5) / 0.28209479177387814),
    )


def seen(color: float = 0.9) -> Seen:
    draw = torch.Generator().manual_seed(0)
    places = 0.4 * torch.rand(20, 2, generator=draw) - 0.2
    surface = torch.cat([torch.zeros(20, 1), places], dim=1)
    return Seen(
        surface=surface,
        ends=surface,
        widths=torch.full((20,), 0.02),
        solid=torch.ones(20, dtype=torch.bool),
        rgb=torch.full((20, 3), color),
    )


def losses_of(gaussians: Gaussians, field: Any, origin_distance: float | None) -> list[float]:
    """Of Gaussians that should show what the plate shows: geometry, texture, spread."""

    def traced(shown: Gaussians, move: Any, canonical: Seen) -> tuple[Traced, torch.Tensor]:
        rays, target = deformed_rays(canonical, EYE, move, origin_distance)
        found = trace(
            carried_by(shown, move),
            rays,
            background=torch.zeros(3),
            footprint=Footprint(),
            pixels=carried_pixels(canonical, move),
        )
        return found, target

    rest, _ = traced(plate(), Identity(), seen())
    canonical = replace(seen(), surface=rest.centroid)
    moved, target = traced(gaussians, field, canonical)
    found = consistency(moved, target, canonical, unit=1.0, reach=0.2)
    return [float(found.geometry), float(found.texture), float(found.spread)]


@pytest.mark.parametrize("origin_distance", [None, 0.1])
def test_a_surface_that_follows_affine_maps_costs_nothing(origin_distance: float | None) -> None:
    shear = torch.eye(3, dtype=torch.float64)
    shear[0, 1] = 0.3
    for field in (Identity(), uniform_scale(2.0), Affine(shear, torch.zeros(3).double())):
        geometry, texture, spread = losses_of(plate(), field, origin_distance)
        assert texture < 0.02
        assert spread < 1e-3
        # A shear orders Gaussians side by side another way, and so blends other means.
        assert geometry < (0.02 if isinstance(field, Affine) and field.matrix[0, 1] else 1e-4)


def test_what_lies_behind_the_surface_costs() -> None:
    behind = replace(plate(0.1), means=plate().means - torch.tensor([0.15, 0.0, 0.0]))
    faint = replace(plate(), opacities=torch.full((49,), 0.3))
    both = Gaussians(**{n: torch.cat([t, vars(behind)[n]]) for n, t in vars(faint).items()})
    clean, mixed = (losses_of(one, uniform_scale(1.5), 0.1) for one in (plate(), both))
    assert all(dirty > 10 * pure for dirty, pure in zip(mixed, clean, strict=True))


def test_rays_that_another_part_hides_count_nothing() -> None:
    before = replace(plate(0.1), means=plate().means + torch.tensor([1.0, 0.0, 0.0]))
    hidden = Gaussians(**{n: torch.cat([t, vars(before)[n]]) for n, t in vars(plate()).items()})
    assert losses_of(hidden, Identity(), None) == [0.0, 0.0, 0.0]
    # Moved origins lie between the two.
    assert losses_of(hidden, Identity(), 0.1)[1] < 0.02


def test_needles_are_what_is_long() -> None:
    scales = torch.tensor([[1.0, 1.0, 0.1], [8.0, 1.0, 0.1]])
    assert needles(scales[:1], 4.0) == 0
    torch.testing.assert_close(needles(scales, 4.0), torch.tensor(2.0).log() / 2)


def test_one_door_and_one_verb_fine_tune_both_kinds(scene: Scene, tmp_path: Path) -> None:
    run = tmp_path / "run"
    asset = pcore.train(scene, START, folder=run, options=RunOptions(light=False))
    memory = pcore.finetune(asset, scene, config(), options=RunOptions(light=False))
    tuned = pcore.finetune(
        asset, scene, config(), folder=tmp_path / "t", options=RunOptions(light=False)
    )
    assert torch.equal(tuned.points, memory.points)
    assert not torch.equal(tuned.points, asset.points)
    assert label_of(tuned) == "Gaussians + P-CORE"
    assert tuned.record.base is not None
    assert tuned.record.config["finetune"]["rays"] == 40
    again = pcore.finetune(
        asset,
        scene,
        config(),
        folder=tmp_path / "t",
        options=RunOptions(light=False, resume=True),
    )
    assert torch.equal(again.points, tuned.points)
    assert main(["finetune", str(run), "--steps", "1", "--threads", "1"]) == 0
    assert pcore.load(tmp_path / "run-pcore").provenance.stage == "finetune"


def test_options_of_networks_are_refused(
    scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    pcore.train(scene, replace(START, steps=1), folder=run, options=RunOptions(light=False))
    assert main(["finetune", str(run), "--skinning", "--front-weight", "1"]) == 2
    told = capsys.readouterr().err
    assert "--front-weight" in told
    assert "--skinning" in told
    with pytest.raises(InputError, match="rays >= 1"):
        config(rays=0)
    with pytest.raises(InputError, match="at least one of"):
        config(points_only=False, rays_and_points=False)
    with pytest.raises(InputError, match="finite number"):
        config(spread_weight=-1.0)

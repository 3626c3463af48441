"""`pcore.train` and `pcore.finetune` make what the commands make."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.cli.toys import toy_surfels, write_run, write_scene
from tests.gaussians.some import some_gaussians
from torch import Tensor

import pcore
from pcore.asset.asset import Asset
from pcore.asset.neural_points import NeuralPoints
from pcore.asset.training import finetune_settings
from pcore.cli.main import main
from pcore.errors import InputError
from pcore.files.run_record import RunRecord
from pcore.relight.lamps import Light, sphere
from pcore.relight.light_file import LIGHT_FILE
from pcore.relight.relighting import Relighting
from pcore.render.surfel_fit import Observed
from pcore.training.presets import (
    finetune_preset,
    gaussian_preset,
    preset,
    skinning_preset,
)

STEPS, POINTS = 4, 200


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scenes") / "ball")


def settings() -> pcore.PretrainConfig:
    return replace(preset("tiny"), steps=STEPS, points=POINTS)


def tuning() -> pcore.FinetuneConfig:
    return replace(finetune_preset("tiny"), steps=2, skinning=skinning_preset("ours"))


def assert_same(first: Asset, second: Asset) -> None:
    assert first.provenance == second.provenance
    one, other = first.content, second.content
    assert isinstance(one, NeuralPoints)
    assert isinstance(other, NeuralPoints)
    for name, tensor in one.papr.state_dict().items():
        assert torch.equal(tensor, other.papr.state_dict()[name]), name
    for name in ("positions", "features", "influence"):
        assert torch.equal(getattr(one.cloud, name), getattr(other.cloud, name)), name
    assert one.surfels is not None
    assert other.surfels is not None
    for name in ("places", "normals", "heights", "beside"):
        assert torch.equal(getattr(one.surfels, name), getattr(other.surfels, name)), name
    assert (first.light is None) == (second.light is None)
    if first.light is not None and second.light is not None:
        assert torch.equal(first.light.light.radiance, second.light.light.radiance)
        assert torch.equal(first.light.received, second.light.received)
    assert (first.skinning is None) == (second.skinning is None)


def ball_light(observed: Observed, positions: Tensor) -> Relighting:
    """A light from above on a ball; what a real one needs is longer training."""
    directions = sphere(40)
    light = Light(
        directions=directions,
        radiance=0.1 + (directions[:, 2] + float(observed.attention.mean()) / 1e3).exp(),
        nearness=torch.zeros(40),
        center=torch.zeros(3),
    )
    bright = torch.full((len(positions),), 0.3)
    return Relighting.of(light, positions, toy_surfels(positions), bright)


def test_training_and_tuning_make_what_the_commands_make(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcore.asset.lighting.fit_light", ball_light)
    words = ["--device", "cpu", "--threads", "1", "--no-tensorboard"]
    steps = ["--steps", str(STEPS), "--points", str(POINTS)]
    run, tuned = tmp_path / "run", tmp_path / "run-pcore"
    assert main(["train", str(scene), "-o", str(run), "--model", "papr", *steps, *words]) == 0
    assert main(["finetune", str(run), "--steps", "2", "--skinning", *words]) == 0
    torch.set_flush_denormal(True)  # As the commands do.
    views = pcore.load_scene(scene)
    notes: list[str] = []
    options = pcore.RunOptions(note=notes.append)
    mine = pcore.train(views, settings(), folder=tmp_path / "mine", options=options)
    assert_same(mine, pcore.load(run))
    assert mine.light is not None
    assert (run / LIGHT_FILE).is_file()
    records = [RunRecord.read(path) for path in (run, tmp_path / "mine")]
    assert records[0].config == records[1].config
    assert records[0].scene == records[1].scene
    assert_same(pcore.train(views, settings()), pcore.load(run))
    # As if killed after the last save of the training.
    (tmp_path / "mine" / LIGHT_FILE).unlink()
    again = pcore.RunOptions(resume=True, note=notes.append)
    assert_same(pcore.train(views, settings(), folder=tmp_path / "mine", options=again), mine)
    assert (tmp_path / "mine" / LIGHT_FILE).is_file()
    dark = pcore.train(views, settings(), options=pcore.RunOptions(light=False))
    assert dark.light is None
    after = pcore.finetune(mine, mine.scene(), tuning(), folder=tmp_path / "tuned")
    assert_same(after, pcore.load(tuned))
    assert after.record.base is not None
    assert after.record.base.samefile(mine.path)
    memory = pcore.finetune(mine, mine.scene(), tuning())
    assert memory.skinning is not None
    kept = memory.save(tmp_path / "kept")
    assert_same(kept, memory)
    assert kept.record.base is not None
    assert kept.record.base.samefile(mine.path)


@pytest.mark.parametrize("kind", ["gaussians", "papr"])
def test_a_run_can_be_made_again_from_its_record(scene: Path, tmp_path: Path, kind: str) -> None:
    config = replace(gaussian_preset("tiny"), steps=STEPS, points=POINTS)
    chosen = settings() if kind == "papr" else config
    options = pcore.RunOptions(light=False)
    views = pcore.load_scene(scene, factor=2)
    first = pcore.train(views, replace(chosen, seed=5), folder=tmp_path / "run", options=options)
    tuned = pcore.finetune(
        first,
        views,
        folder=tmp_path / "tuned",
        options=options,
        settings=(replace(finetune_settings(first)[1], steps=2, seed=7)),
    )
    for made in (first, tuned):
        record = json.loads((made.path / "run.json").read_text())
        (began,) = record["notes"]["made_by"]
        assert (began["step"], began["device"]) == (0, "cpu")
        assert began["threads"] == torch.get_num_threads()
        assert began["torch"] == torch.__version__
    asset = pcore.load(tmp_path / "run")
    assert asset.settings == replace(chosen, seed=5)
    again = pcore.train(asset.scene(), asset.settings, options=options)
    assert torch.equal(again.points, first.points)
    more = pcore.load(tmp_path / "tuned")
    assert more.settings.seed == 7
    repeated = pcore.finetune(again, more.scene(), more.settings, options=options)
    camera = views.split("test")[0].camera
    assert torch.equal(repeated.render(None, camera).rgb, tuned.render(None, camera).rgb)


def test_what_was_imported_has_no_settings(tmp_path: Path) -> None:
    papr, cloud = write_run(tmp_path / "run")
    with pytest.raises(InputError, match="got one without settings on record"):
        _ = pcore.asset_of(papr, cloud).settings


def test_a_loop_of_ones_own_leaves_the_run_that_it_began_with(scene: Path, tmp_path: Path) -> None:
    config = replace(gaussian_preset("tiny"), steps=STEPS, points=POINTS)
    masks = tmp_path / "deep" / "masks"
    masks.mkdir(parents=True)
    options = pcore.RunOptions(light=False)
    run = pcore.train(pcore.load_scene(scene), config, folder=tmp_path / "run", options=options)
    run = replace(
        run, record=replace(run.record, config={**run.record.config, "masks": "../deep/masks"})
    )
    before = {path.name: path.read_bytes() for path in run.path.iterdir() if path.is_file()}
    gaussians = run.content.gaussians
    mine = pcore.asset_of(replace(gaussians, means=gaussians.means + 0.01), like=run, step=3)
    assert mine.content.normals is None
    assert mine.provenance.step == 3
    assert mine.content.footprint == run.content.footprint
    with pytest.raises(InputError, match="never saved"):
        _ = mine.path
    kept = mine.save(tmp_path / "far" / "away" / "mine")
    assert kept.record.masks is not None
    assert kept.record.masks.samefile(masks)
    assert kept.record.scene_folder is not None
    assert kept.record.scene_folder.samefile(scene)
    assert {path.name: path.read_bytes() for path in run.path.iterdir() if path.is_file()} == before


def test_parts_of_another_kind_of_object(scene: Path, tmp_path: Path) -> None:
    papr, cloud = write_run(tmp_path / "run")
    points = pcore.load(tmp_path / "run")
    with pytest.raises(InputError, match="the canonical points too"):
        pcore.asset_of(papr)
    with pytest.raises(InputError, match="`like` to be one of Gaussians, got NeuralPoints"):
        pcore.asset_of(some_gaussians(5), like=points)
    with pytest.raises(InputError, match="got GaussianContent"):
        pcore.asset_of(papr, like=pcore.asset_of(some_gaussians(5)))
    with pytest.raises(InputError, match="networks"):
        pcore.asset_of(papr, cloud, like=pcore.asset_of(some_gaussians(5)))
    assert torch.equal(pcore.asset_of(papr, like=points).points, cloud.positions)


def test_a_finished_run_is_handed_over(scene: Path, tmp_path: Path) -> None:
    views, notes = pcore.load_scene(scene), list[str]()
    config = replace(settings(), steps=1)
    first = pcore.train(
        views, config, folder=tmp_path / "run", options=pcore.RunOptions(light=False)
    )
    again = pcore.RunOptions(light=False, resume=True, note=notes.append)
    assert_same(pcore.train(views, config, folder=tmp_path / "run", options=again), first)
    assert notes == ["finished already; nothing is left to do"]
    with pytest.raises(InputError, match="holds a run already"):
        pcore.train(views, config, folder=tmp_path / "run")


def test_a_light_that_cannot_be_estimated_is_said(scene: Path) -> None:
    notes: list[str] = []
    config = replace(settings(), steps=1, points=30)
    options = pcore.RunOptions(note=notes.append)
    asset = pcore.train(pcore.load_scene(scene), config, options=options)
    assert asset.light is None
    assert len(notes) == 1
    assert "points with a normal" in notes[0]
    with pytest.raises(InputError, match="points with a normal"):
        pcore.estimate_light(asset, asset.scene())


def test_settings_by_name_know_their_name(scene: Path) -> None:
    config = replace(preset("tiny"), steps=1, points=40)
    options = pcore.RunOptions(light=False)
    asset = pcore.train(pcore.load_scene(scene, factor=2), config, options=options)
    assert asset.record.config["preset"] == "tiny"
    assert asset.record.factor == 2
    named = pcore.RunOptions(light=False, preset="mine")
    asset = pcore.train(pcore.load_scene(scene), config, options=named)
    assert asset.record.config["preset"] == "mine"

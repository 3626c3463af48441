"""PAPR-in-Motion's stages: what each changes, and what it needs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import tiny_scene
from pcore.asset.saving import load, neural_points_of
from pcore.errors import InputError
from pcore.evaluation.contest import Contest
from pcore.evaluation.contestants import Given
from pcore.evaluation.motion_method import STAGES, end_views, has_end_views, motion_entries
from pcore.evaluation.states import SceneStates, open_states
from pcore.rivals.motion_stages import MotionConfig, fit_motion

CONFIG = MotionConfig(steps=30, neighbours=8, side=24)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A state `grown` with training photos, and `walk` without."""
    root = tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")
    other = tmp_path_factory.mktemp("scenes") / "grown"
    tiny_scene.write_scene(other, meshes=False, states=False)
    shutil.copytree(other / "train", root / "grown" / "train")
    shutil.copy(other / "transforms_train.json", root / "grown")
    return root


@pytest.fixture
def places(scene: Path) -> SceneStates:
    return open_states(scene)


def test_the_first_stage_moves_points_and_the_second_their_looks(
    places: SceneStates, scene: Path, tmp_path: Path
) -> None:
    content = neural_points_of(load(tiny_scene.write_run(tmp_path / "run", scene)), "test")
    papr, cloud = content.papr, content.cloud
    before = {name: tensor.clone() for name, tensor in papr.state_dict().items()}
    found = fit_motion(papr, cloud, end_views(places, "grown"), CONFIG)
    assert not torch.equal(found.positions, cloud.positions)
    assert not torch.equal(found.features, cloud.features)
    assert all(torch.equal(before[name], t) for name, t in papr.state_dict().items())
    first, moved = found.stage(1, papr, cloud)
    assert first is papr
    assert torch.equal(moved.features, cloud.features)
    second, tuned = found.stage(2, papr, cloud)
    assert torch.equal(tuned.positions, moved.positions)
    assert torch.equal(tuned.influence, cloud.influence)
    after = second.state_dict()
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"attention"}


def test_there_must_be_more_points_than_neighbours(
    places: SceneStates, scene: Path, tmp_path: Path
) -> None:
    content = neural_points_of(load(tiny_scene.write_run(tmp_path / "run", scene)), "test")
    with pytest.raises(InputError, match="more than 100 points, got 6 and 60"):
        fit_motion(content.papr, content.cloud, places.scene.split("train"), MotionConfig())


def test_states_without_photos_say_so(places: SceneStates, scene: Path, tmp_path: Path) -> None:
    asset = load(tiny_scene.write_run(tmp_path / "run", scene))
    record = replace(asset.record, notes={"processor_seconds": 100.0})
    run = Given(asset=replace(asset, record=record), stamp="x")
    states = places.select(["all"])
    assert has_end_views(places, states)
    assert not has_end_views(places, places.select(["walk"]))
    entries = motion_entries([run], places, tmp_path / "trained", CONFIG)
    assert [one.name for one in entries] == [*STAGES.values()]
    contest = Contest(folder=tmp_path / "out", states=states, stamp="x")
    outcomes = {(one.name, one.state): one for one in contest.run(entries)}
    for title in STAGES.values():
        assert outcomes[title, "grown"].failed is None
        assert "expected training photos of it" in (outcomes[title, "walk"].failed or "")
    one, two = (outcomes[title, "grown"].rows[0].scores for title in STAGES.values())
    assert one["strain_99"] == two["strain_99"]
    assert one["psnr"] != two["psnr"]
    cost = outcomes[STAGES[2], "grown"].cost
    assert cost.seconds is not None
    assert cost.seconds > 100.0  # Of the object, and of both stages on it.
    assert cost.megabytes
    assert outcomes[STAGES[2], "canonical"].cost.seconds is None
    # Both rows are of one training.
    (kept,) = (tmp_path / "trained").glob("motion-run-grown-*.safetensors")
    # One damaged file is a row, and stops nothing.
    kept.write_bytes(kept.read_bytes()[:100])
    entries = motion_entries([run], places, tmp_path / "trained", CONFIG)
    again = replace(contest, stamp="y").run(entries)
    assert [one.state for one in again if one.failed is None] == ["canonical"] * 2
    assert "delete it" in (again[1].failed or "")


def test_another_training_or_other_steps_are_learned_anew(
    places: SceneStates, scene: Path, tmp_path: Path
) -> None:
    run = Given(asset=load(tiny_scene.write_run(tmp_path / "run", scene)), stamp="x")
    (grown,) = (state for state in places.select(["grown"]) if state.name == "grown")
    brief = replace(CONFIG, steps=1)

    def learn(given: Given, config: MotionConfig) -> None:
        method = motion_entries([given], places, tmp_path, config)[0].make().method
        method.pose(grown)

    learn(run, brief)
    learn(run, brief)
    assert len([*tmp_path.glob("motion-*.safetensors")]) == 1
    learn(replace(run, stamp="y"), brief)
    learn(run, replace(brief, steps=2))
    assert len([*tmp_path.glob("motion-*.safetensors")]) == 3

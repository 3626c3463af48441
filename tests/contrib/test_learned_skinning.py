"""The skinning network, its prior, and its file."""

import json
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from pcore.contrib.learned_skinning import Skinning, SkinningConfig, untrained_skinning
from pcore.deform.anchor_distance import (
    StraightDistance,
    anchor_spacing,
    distance_weigher,
    path_distance,
)
from pcore.errors import CheckpointError, InputError
from pcore.files.skinning_file import SKINNING_FILE, load_skinning, save_skinning
from pcore.geometry.farthest_points import farthest_points

POINTS = torch.rand(200, 3, generator=torch.Generator().manual_seed(2))
DISTANCE = path_distance(POINTS, farthest_points(POINTS, 16))
SMALL = SkinningConfig(neighbours=5, frequencies=2, layers=2, width=8)


def perturbed(config: SkinningConfig = SMALL) -> Skinning:
    skinning = untrained_skinning(DISTANCE, config)
    with torch.no_grad():
        skinning.network.layers[-1].weight.normal_()
    return skinning


@pytest.mark.parametrize("along_cloud", [True, False])
def test_untrained_it_skins_by_distance(along_cloud: bool) -> None:
    config = SkinningConfig(along_cloud=along_cloud, start_sigma=0.5)
    distance = DISTANCE if along_cloud else StraightDistance(anchors=DISTANCE.anchors)
    sigma = 0.5 * anchor_spacing(DISTANCE.between)
    found = untrained_skinning(DISTANCE, config)(POINTS)
    expected = distance_weigher(distance, sigma=sigma)(POINTS)
    assert torch.equal(found.anchors, expected.anchors)
    torch.testing.assert_close(found.values, expected.values)


def test_without_a_start_all_candidates_weigh_the_same() -> None:
    found = untrained_skinning(DISTANCE, SkinningConfig(start_sigma=None))(POINTS)
    torch.testing.assert_close(found.values, torch.full((200, 8), 1 / 8))


def test_weights_are_the_softmax_of_the_candidates_logits() -> None:
    skinning = perturbed(SkinningConfig(neighbours=5, start_sigma=None))
    prior = skinning.prior(POINTS)
    logits = skinning.network(POINTS)
    assert logits.shape == (200, 16)
    found = skinning.weights(POINTS, prior)
    for row in (0, 99):
        chosen = logits[row, prior.candidates[row]]
        torch.testing.assert_close(found.values[row], torch.softmax(chosen, dim=0))
    some = torch.tensor([3, 8])
    again = skinning.weights(POINTS[some], prior.rows(some))
    torch.testing.assert_close(again.values, found.values[some])


def test_units_do_not_matter() -> None:
    big = path_distance(10 * POINTS, DISTANCE.indices)
    here = untrained_skinning(DISTANCE, SMALL)
    there = untrained_skinning(big, SMALL)
    there.network.layers.load_state_dict(here.network.layers.state_dict())
    torch.testing.assert_close(there(10 * POINTS).values, here(POINTS).values, atol=1e-4, rtol=1e-4)


def test_the_seed_decides_and_the_global_generator_is_left_alone() -> None:
    state = torch.get_rng_state()
    first, second = (untrained_skinning(DISTANCE, SMALL, seed=7).network for _ in range(2))
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(first.layers[0].weight, second.layers[0].weight)
    other = untrained_skinning(DISTANCE, SMALL, seed=8).network
    assert not torch.equal(first.layers[0].weight, other.layers[0].weight)


def test_gradients_reach_the_network() -> None:
    skinning = perturbed()
    skinning.weights(POINTS, skinning.prior(POINTS)).values.square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in skinning.network.parameters())


def test_bad_configuration() -> None:
    with pytest.raises(InputError, match="expected start_sigma above 0 or None, got 0"):
        SkinningConfig(start_sigma=0.0)
    with pytest.raises(InputError, match="width: expected a whole number of at least 1, got 0"):
        SkinningConfig(width=0)


# --- the file ---------------------------------------------------------------------------------


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save_skinning(tmp_path / SKINNING_FILE, perturbed())
    return tmp_path / SKINNING_FILE


def rewrite(path: Path, *, tensors: dict | None = None, header: dict | None = None) -> None:
    with safe_open(path, framework="pt") as file:
        content = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        lines = dict(file.metadata())
    save_file({**content, **(tensors or {})}, path, metadata={**lines, **(header or {})})


def test_it_comes_back_with_the_same_weights(tmp_path: Path) -> None:
    skinning = perturbed()
    save_skinning(tmp_path / SKINNING_FILE, skinning)
    loaded = load_skinning(tmp_path, POINTS)
    assert loaded.network.config == SMALL
    assert loaded.sigma == skinning.sigma
    here, there = skinning(POINTS), loaded(POINTS)
    assert torch.equal(here.anchors, there.anchors)
    assert torch.equal(here.values, there.values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"header": {"version": "2"}}, "of version 1, got 'pcore-skinning' of version '2'"),
        ({"header": {"format": "pcore-model"}}, "expected the format 'pcore-skinning'"),
        ({"header": {"config": "{"}}, "expected a JSON object under 'config'"),
        ({"header": {"config": json.dumps({"width": 8})}}, "missing key"),
        ({"tensors": {"network.center": torch.full((3,), torch.nan)}}, "infinity in network"),
        ({"tensors": {"network.center": torch.zeros(4)}}, "not those of its configuration"),
        ({"tensors": {"places": torch.zeros(16, 3)}}, "expected the points that the skinning"),
    ],
)
def test_bad_files(saved: Path, change: dict, message: str) -> None:
    rewrite(saved, **change)
    with pytest.raises(CheckpointError, match=message):
        load_skinning(saved, POINTS)


def test_other_points_damage_and_absence(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="expected the points that the skinning was fitted"):
        load_skinning(saved, POINTS + 1)
    with pytest.raises(CheckpointError, match=r"expected the points .* got 3 others"):
        load_skinning(saved, POINTS[:3])
    saved.write_bytes(saved.read_bytes()[:100])
    with pytest.raises(CheckpointError, match="damaged or not a safetensors file"):
        load_skinning(saved, POINTS)
    with pytest.raises(CheckpointError, match="no skinning at"):
        load_skinning(tmp_path / "nowhere", POINTS)


def test_weights_gone_wrong_never_replace_good_ones(saved: Path) -> None:
    before = saved.read_bytes()
    skinning = perturbed()
    with torch.no_grad():
        skinning.network.layers[0].bias[0] = torch.inf
    with pytest.raises(CheckpointError, match=r"infinity in network\.layers\.0\.bias"):
        save_skinning(saved, skinning)
    assert saved.read_bytes() == before

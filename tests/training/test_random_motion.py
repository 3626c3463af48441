"""How a field moves points and surface points: by its formula, or by a skinning that learns."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from pcore.contrib.skinning_loss import position_loss
from pcore.deform.base import Affine, Deformation
from pcore.deform.motion import rigid
from pcore.deform.skinning import pose_of
from pcore.errors import InputError
from pcore.training.config import SkinningTrainConfig
from pcore.training.consistency import Canonical
from pcore.training.random_motion import FieldMotion, MovedScene, SkinnedMotion, skinning_to_train
from small_training import SKINNING, box_cloud

CLOUD = box_cloud()
SHEAR = Affine(torch.eye(3) + torch.tensor([[0, 0.3, 0], [0, 0, 0.2], [0.1, 0, 0]]), torch.ones(3))
TURN = rigid("z", 0.5, (1.0, 0.0, 0.0))
UNIT = 2.0


def canonical(*, met: bool = True) -> Canonical:
    """A patch whose first row lies on points of the cloud; the second row is background."""
    surface = torch.stack([CLOUD.positions[:5], 3 * CLOUD.positions[5:10]])
    foreground = torch.tensor([[met] * 5, [False] * 5])
    return Canonical(surface=surface, foreground=foreground, ends=surface, rgb=surface)


def motion(config: SkinningTrainConfig = SKINNING, *, aware: bool = False) -> SkinnedMotion:
    skinning = skinning_to_train(CLOUD, config, seed=0)
    with torch.no_grad():
        skinning.network.layers[-1].weight.normal_()
    prior = skinning.prior(CLOUD.positions)
    return SkinnedMotion(skinning=skinning, prior=prior, config=config, unit=UNIT, aware=aware)


def gradient(skinned: SkinnedMotion, loss: torch.Tensor) -> float:
    """Size of the gradient that reaches the skinning network."""
    found = torch.autograd.grad(loss, skinned.skinning.network.layers[-1].weight, allow_unused=True)
    return 0.0 if found[0] is None else float(found[0].abs().sum())


@pytest.mark.parametrize("aware", [False, True])
def test_a_field_takes_everything_along(aware: bool) -> None:
    moved = FieldMotion(aware=aware)(CLOUD, canonical(), SHEAR)
    assert torch.equal(moved.posed.positions, SHEAR(CLOUD.positions))
    assert torch.equal(moved.surface, SHEAR(canonical().surface))
    assert (moved.posed.local_maps is not None) is aware
    assert not moved.terms


@pytest.mark.parametrize("aware", [False, True])
def test_a_rigid_field_is_the_same_by_skinning(aware: bool) -> None:
    by_field = FieldMotion(aware=aware)(CLOUD, canonical(), TURN)
    skinned = motion(aware=aware)(CLOUD, canonical(), TURN)
    close = {"atol": 1e-5, "rtol": 0.0}
    torch.testing.assert_close(skinned.posed.positions, by_field.posed.positions, **close)
    torch.testing.assert_close(skinned.surface, by_field.surface, **close)
    if by_field.posed.local_maps is not None and skinned.posed.local_maps is not None:
        expected, found = by_field.posed.local_maps, skinned.posed.local_maps
        torch.testing.assert_close(found.to_rest, expected.to_rest, **close)
    assert float(skinned.terms["skinning"].detach()) < 1e-8


def test_surface_points_go_where_the_points_beside_them_go() -> None:
    skinned = motion()
    moved = skinned(CLOUD, canonical(), SHEAR)
    points = moved.posed.positions
    assert float((points - SHEAR(CLOUD.positions)).detach().norm(dim=1).max()) > 0.01
    torch.testing.assert_close(moved.surface[0], points[:5], atol=1e-5, rtol=0)
    # Nothing of the object lies on rays of the background.
    assert torch.equal(moved.surface[1], SHEAR(canonical().surface[1]))
    assert gradient(skinned, moved.surface.sum()) > 0
    assert gradient(skinned, skinned(CLOUD, canonical(), SHEAR).posed.positions.sum()) > 0


def test_the_target_may_be_the_field() -> None:
    skinned = motion(replace(SKINNING, surface_target="field"))
    moved = skinned(CLOUD, canonical(), SHEAR)
    assert torch.equal(moved.surface, SHEAR(canonical().surface))
    assert not moved.surface.requires_grad
    assert gradient(skinned, moved.posed.positions.sum()) > 0


def test_a_patch_without_the_object() -> None:
    moved = motion()(CLOUD, canonical(met=False), SHEAR)
    assert torch.equal(moved.surface, SHEAR(canonical().surface))


def direct_term(moved: MovedScene, field: Deformation) -> torch.Tensor:
    return position_loss(moved.posed.positions, CLOUD.positions, field, UNIT)


def test_the_direct_term_is_weighted_and_optional() -> None:
    skinned = motion(replace(SKINNING, position_weight=7.0))
    moved = skinned(CLOUD, canonical(), SHEAR)
    assert moved.terms["skinning"].item() == pytest.approx(7 * direct_term(moved, SHEAR).item())
    assert gradient(skinned, moved.terms["skinning"]) > 0
    assert not motion(replace(SKINNING, position_weight=0.0))(CLOUD, canonical(), SHEAR).terms


def test_local_maps_are_the_blended_rotations() -> None:
    skinned = motion(aware=True)
    maps = skinned(CLOUD, canonical(), SHEAR).posed.local_maps
    assert maps is not None
    pose = pose_of(SHEAR, skinned.skinning.anchors)
    weights = skinned.skinning.weights(CLOUD.positions, skinned.prior)
    blended = (weights.values[..., None, None] * pose.rotations[weights.anchors]).sum(dim=1)
    expected = torch.linalg.inv(blended.detach())
    torch.testing.assert_close(maps.to_rest, expected, atol=1e-4, rtol=1e-4)
    assert not maps.to_rest.requires_grad


def test_the_seed_is_that_of_the_network_not_of_the_anchors() -> None:
    first, second = (skinning_to_train(CLOUD, SKINNING, seed=seed) for seed in (0, 1))
    assert torch.equal(first.paths.indices, second.paths.indices)
    assert not torch.equal(first.network.layers[0].weight, second.network.layers[0].weight)


def test_more_anchors_than_points() -> None:
    with pytest.raises(InputError, match="expected at least 61 points to choose from, got 60"):
        skinning_to_train(CLOUD, replace(SKINNING, anchors=61), seed=0)

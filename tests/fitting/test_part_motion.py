"""Parts that move as wholes: they are found in a pose, and fitted as such."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from banded_rod import SIDE, armed, cameras, rod, write_photos
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.capture.load import load_scene
from pcore.deform.skinning import AnchorPose, pose_of
from pcore.editing.script import parse_edit
from pcore.fitting.anchor_motion import AnchorSpace, rotation_matrices
from pcore.fitting.fit_config import JOINTED, FitConfig, FitStage
from pcore.fitting.fit_photos import photos_of
from pcore.fitting.fitted_edit import anchor_rig
from pcore.fitting.fitter import Fitter
from pcore.fitting.part_motion import PartSpace, rigid_parts
from pcore.fitting.pose_fit import rigid_limbs
from pcore.fitting.shown_object import Shown

CONFIG = FitConfig(
    anchors=40,
    parts=(FitStage(pixels=32, steps=40, rate=0.05, stiffness=0.01, spread=0.0),),
    jointed=FitStage(pixels=32, steps=5, rate=0.02, stiffness=0.02, spread=0.5),
)


def rod_space() -> AnchorSpace:
    """Twenty anchors on a line, each linked to the next."""
    rest = torch.zeros(20, 3)
    rest[:, 0] = torch.arange(20.0)
    links = torch.stack([torch.arange(19), torch.arange(1, 20)], dim=1)
    return AnchorSpace(rest=rest, links=links, weights=torch.ones(19), spacing=1.0)


def folded(space: AnchorSpace, angle: float, noise: float = 0.0) -> AnchorPose:
    """The line bent at its twelfth anchor; the rest stays."""
    turn = rotation_matrices(torch.tensor([[0.0, 0.0, angle]]))[0]
    joint = torch.tensor([11.5, 0.0, 0.0])
    swung = (space.rest - joint) @ turn.mT + joint
    outer = space.rest[:, 0] > 11.5
    moved = torch.where(outer[:, None], swung, space.rest)
    turns = torch.where(outer[:, None, None], turn, torch.eye(3))
    shaken = noise * torch.randn(20, 3, generator=torch.Generator().manual_seed(0))
    return AnchorPose(rest=space.rest, moved=moved + shaken, rotations=turns)


def expected() -> Tensor:
    return (torch.arange(20) > 11).long()


def test_limbs_are_found_where_they_bend() -> None:
    space = rod_space()
    for scale in (1.0, 1000.0):
        pose = folded(space, 1.2, noise=0.05)
        large = AnchorPose(
            rest=scale * pose.rest, moved=scale * pose.moved, rotations=pose.rotations
        )
        assert torch.equal(rigid_parts(large, space.links, scale), expected())
    whole = folded(space, 0.0)
    assert torch.equal(rigid_parts(whole, space.links, 1.0), torch.zeros(20).long())


def test_what_turns_by_itself_is_a_part() -> None:
    space = rod_space()
    still = folded(space, 0.0)
    twist = rotation_matrices(torch.tensor([[2.0, 0.0, 0.0]]))[0]
    turns = torch.where((expected() == 1)[:, None, None], twist, torch.eye(3))
    assert torch.equal(rigid_parts(replace(still, rotations=turns), space.links, 1.0), expected())


def test_numbers_of_parts_are_those_of_their_pose() -> None:
    space = rod_space()
    pose = folded(space, 1.2)
    parts = PartSpace.found(space, pose)
    numbers = parts.numbers(pose)
    assert numbers.shape == (2, 6)
    assert torch.allclose(parts.pose(numbers).moved, pose.moved, atol=1e-4)
    assert torch.allclose(parts.pose(numbers).rotations, pose.rotations, atol=1e-5)
    shaken = parts.pose(parts.numbers(folded(space, 1.2, noise=0.1)))
    assert torch.allclose(shaken.rotations[expected() == 0], shaken.rotations[0].expand(12, 3, 3))


def test_joints_bend_and_limbs_do_not() -> None:
    space = rod_space()
    pose = folded(space, 1.2)
    jointed = PartSpace.found(space, pose).jointed()
    assert float(jointed.bending(pose)) < 0.1 * float(space.bending(pose))
    shaken = folded(space, 0.0, noise=0.3)
    assert float(jointed.bending(shaken)) > 0.8 * float(space.bending(shaken))


def raised_numbers(fitter: Fitter, raised: Asset) -> tuple[Tensor, Tensor]:
    """Numbers (M, 6) of the anchors of an arm that is raised by 0.8, and which are in it."""
    moved = raised.points[fitter.rig.indices].float()
    arm = (moved - fitter.space.rest).norm(dim=1) > 1e-4
    turn = rotation_matrices(torch.tensor([[0.0, -0.8, 0.0]]))[0]
    turns = torch.where(arm[:, None, None], turn, torch.eye(3))
    pose = AnchorPose(rest=fitter.space.rest, moved=moved, rotations=turns)
    return fitter.space.numbers(pose), arm


def stained(asset: Asset, size: float) -> Asset:
    """The object with other colours: by so much each, at random."""
    content = asset.content
    assert isinstance(content, GaussianContent)
    own = content.gaussians
    stains = size * torch.randn(own.sh.shape, generator=torch.Generator().manual_seed(4))
    return replace(asset, content=replace(content, gaussians=replace(own, sh=own.sh + stains)))


@pytest.mark.parametrize("known", [True, False])
def test_a_crumpled_arm_is_fitted_as_a_whole(tmp_path: Path, known: bool) -> None:
    asset, raised = armed(0.0), armed(0.8)
    photos = write_photos(tmp_path / "raised", raised, None, cameras(6))
    fitter = Fitter(Shown.of(asset), anchor_rig(asset.points, None, CONFIG))
    true, arm = raised_numbers(fitter, raised)
    noise = 0.25 * torch.randn(true.shape, generator=torch.Generator().manual_seed(1))
    start = true if known else true + noise * arm[:, None]
    views = photos_of(load_scene(photos).split("train"), torch.device("cpu"))
    found = rigid_limbs(fitter, start, views, CONFIG, lambda: None)

    def miss(numbers: Tensor) -> float:
        places = fitter.skinned(fitter.space.pose(numbers)).positions
        return float((places - raised.points).norm(dim=1).mean())

    assert miss(found) < (1.1 * miss(true) + 0.005 if known else 0.6 * miss(start))


def test_limbs_do_not_bend_to_colours_that_nothing_shows(tmp_path: Path) -> None:
    asset, raised = armed(0.0), armed(0.8)
    photos = write_photos(tmp_path / "raised", stained(raised, 0.7), None, cameras(6))
    fitter = Fitter(Shown.of(asset), anchor_rig(asset.points, None, CONFIG))
    true, _ = raised_numbers(fitter, raised)
    views = photos_of(load_scene(photos).split("train"), torch.device("cpu"))
    parts = PartSpace.found(fitter.space, fitter.space.pose(true))
    stage = replace(JOINTED, pixels=32, steps=60)
    found = fitter.within(parts.jointed()).stage(true, views, stage, CONFIG, lambda: None)
    places, best = (
        fitter.skinned(fitter.space.pose(numbers)).positions for numbers in (found, true)
    )
    pixel = 4 * 2 * math.tan(0.3) / SIDE
    assert float((places - best).norm(dim=1).mean()) < 0.07 * pixel


def test_what_bends_everywhere_keeps_its_anchors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asset = rod()
    bend = {"version": 2, "edits": [{"type": "bend", "axis": "z", "angle_deg": 70}]}
    photos = write_photos(tmp_path / "bent", asset, asset.pose(bend), cameras(3))
    fitter = Fitter(Shown.of(asset), anchor_rig(asset.points, None, CONFIG))
    true = pose_of(parse_edit(bend).bind(asset.points), fitter.rig.graph.rest)
    start = fitter.space.numbers(true)
    views = photos_of(load_scene(photos).split("train"), torch.device("cpu"))
    # One rigid part cannot bend at all, and one step does not mend that.
    monkeypatch.setattr("pcore.fitting.part_motion._APART", 1e3)
    config = replace(
        CONFIG,
        parts=tuple(replace(stage, steps=1) for stage in CONFIG.parts),
        jointed=replace(CONFIG.jointed, steps=1),
    )
    assert torch.equal(rigid_limbs(fitter, start, views, config, lambda: None), start)

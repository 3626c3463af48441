"""Anchors that disagree and handles that are far away, on a bar that is bent."""

import pytest
import torch

from pcore.deform.base import Deformation
from pcore.deform.motion import rigid
from pcore.deform.skinning import pose_of
from pcore.editing.anchors import rig_of
from pcore.editing.handles import diagnose_handles, handle_colors, handles_of
from pcore.editing.script import parse_edit
from pcore.errors import EditError


def bar(count: int = 3000) -> torch.Tensor:
    """Points of a bar along x from -1 to 1, 0.2 thick."""
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) * 2 - 1
    return points * torch.tensor([1.0, 0.1, 0.1])


BAR = bar()
WAYS = ((1, 0.6), (0.6, 0.3), (0.2, 0.1), (-0.2, 0), (-0.6, 0), (-1, 0))


def script(**keys: object):
    handle = {"near": [1, 0, 0], "to": [1, 0, 0.6]}
    return parse_edit({"version": 2, "edits": [{"type": "anchors", "handles": [handle], **keys}]})


@pytest.fixture(scope="module")
def bend() -> Deformation:
    """A bar bent into three quarters of a circle."""
    edit = {"type": "bend", "axis": "z", "angle_deg": 270}
    return parse_edit({"version": 2, "edits": [edit]}).bind(BAR)


def test_few_anchors_disagree_about_a_bend_and_many_do_not(bend: Deformation):
    shares = {}
    for count in (5, 20, 128):
        rig = rig_of(BAR, count=count)
        pose = pose_of(bend, rig.graph.rest)
        found = diagnose_handles(rig, pose, range(count))
        shares[count] = found.numbers()["anchors_disagree"]
        assert found.numbers()["without_handle"] == 0  # All anchors are given.
    assert shares[5] > 0.5
    assert shares[5] > shares[20] > shares[128]
    assert shares[128] == 0


def test_where_anchors_disagree_is_where_skinning_is_wrong(bend: Deformation):
    rig = rig_of(BAR, count=12)
    pose = pose_of(bend, rig.graph.rest)
    error = (rig.deformation(pose)(BAR) - bend(BAR)).norm(dim=1)
    found = diagnose_handles(rig, pose, range(12))
    wrong = error[found.torn].mean()
    assert wrong > 2 * error[~found.torn].mean()


def test_a_rigid_motion_needs_one_anchor_only():
    rig = rig_of(BAR, count=5)
    pose = pose_of(rigid((1, 2, 3), 2.0, (0, 1, 0)), rig.graph.rest)
    found = diagnose_handles(rig, pose, range(5))
    assert float(found.disagreement.max()) < 1e-6
    with pytest.raises(EditError, match="at least one anchor with a handle"):
        diagnose_handles(rig, pose, ())


def test_a_handle_that_pulls_everything_leaves_most_of_it_loose():
    (all_follow,) = handles_of(script(count=40, reach=100), BAR).values()
    share = all_follow.numbers()["without_handle"]
    # The handle is at one end of 2: 15 percent of the size are 0.3.
    assert share == pytest.approx(0.85, abs=0.1)
    assert not bool(all_follow.loose[BAR[:, 0] > 0.8].any())
    assert bool(all_follow.loose[BAR[:, 0] < 0.5].all())


def test_one_handle_of_the_usual_reach_leaves_the_far_part_of_a_limb_to_nobody():
    (one,) = handles_of(script(), BAR).values()
    assert 0.05 < one.numbers()["without_handle"] < 0.15
    assert bool((BAR[one.loose][:, 0] < 0.8).all())
    assert not bool(one.loose[BAR[:, 0] < 0.4].any())  # It is out of reach and stays.
    painted = handle_colors([one], len(BAR))
    assert len(painted.unique(dim=0)) > 1
    # A handle where the limb is to stay says what that part does.
    joint = {"near": [0.6, 0, 0], "to": [0.6, 0, 0]}
    hand = {"near": [1, 0, 0], "to": [1, 0, 0.6]}
    (two,) = handles_of(script(handles=[hand, joint]), BAR).values()
    assert two.numbers()["without_handle"] < 0.005


def test_handles_all_along_leave_nothing_loose():
    pinned = [{"near": [x, 0, 0], "to": [x, 0, z]} for x, z in WAYS]
    (found,) = handles_of(script(count=40, reach=100, handles=pinned), BAR).values()
    assert found.numbers()["without_handle"] == 0


def test_edits_are_numbered_and_others_say_nothing():
    edits = [
        {"type": "rigid", "translation": [0, 0, 1]},
        {"type": "anchors", "count": 40, "handles": [{"near": [1, 0, 1], "to": [1, 0, 2]}]},
    ]
    assert list(handles_of(parse_edit({"version": 2, "edits": edits}), BAR)) == [2]
    assert handles_of(parse_edit({"version": 2, "edits": edits[:1]}), BAR) == {}

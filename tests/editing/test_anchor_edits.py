"""Posing anchors: rotations from neighbours, as-rigid-as-possible drags, the edit."""

import math
import time
from pathlib import Path

import pytest
import torch
from benchmarks.surface_samples import load_samples
from pydantic import ValidationError

from pcore.deform.anchor_distance import distance_weigher, path_distance
from pcore.deform.motion import rigid
from pcore.editing.anchors import anchor_graph, pose_from_places, rig_of, rig_with
from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.arap import Dragger, Handle, drag
from pcore.editing.script import parse_edit
from pcore.errors import EditError, InputError
from pcore.evaluation.ground_truth import load_truth
from pcore.geometry.farthest_points import farthest_points


def bar(count: int = 600) -> torch.Tensor:
    """Points of a bar along x from -1 to 1, 0.2 thick."""
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) * 2 - 1
    return points * torch.tensor([1.0, 0.1, 0.1])


BAR = bar()
RIG = rig_of(BAR, count=40)
LEFT, RIGHT = int(RIG.graph.rest[:, 0].argmin()), int(RIG.graph.rest[:, 0].argmax())


def handles(**changes: object) -> dict:
    return {"type": "anchors", "count": 40, "handles": [{"anchor": RIGHT, "to": [1, 0, 0.5]}]} | (
        changes
    )


# --- rotations from places ----------------------------------------------------------------------


def test_all_anchors_hang_together() -> None:
    two = torch.cat([BAR, BAR + torch.tensor([0.0, 0.0, 3.0])])
    distance = path_distance(two, farthest_points(two, 30))
    graph = anchor_graph(distance.anchors, distance.between)
    reached = {0}
    for _ in range(30):
        reached |= {b for a, b in graph.links.tolist() if a in reached}
        reached |= {a for a, b in graph.links.tolist() if b in reached}
    assert len(reached) == 30
    assert (graph.weights > 0).all()
    assert torch.isfinite(graph.between).all()


def test_a_rigid_motion_of_the_anchors_is_a_rigid_motion_of_everything() -> None:
    motion = rigid([1.0, 1.0, 0.0], 2.0, [0.0, 3.0, 1.0])
    pose = pose_from_places(RIG.graph, motion(RIG.graph.rest))
    torch.testing.assert_close(RIG.deformation(pose)(BAR), motion(BAR), atol=1e-5, rtol=0)


def test_places_must_fit() -> None:
    with pytest.raises(EditError, match=r"expected finite places \(40, 3\), got \(39, 3\)"):
        pose_from_places(RIG.graph, RIG.graph.rest[1:])
    with pytest.raises(EditError, match="with NaN or infinity"):
        pose_from_places(RIG.graph, RIG.graph.rest * torch.nan)


def test_a_graph_needs_two_anchors() -> None:
    with pytest.raises(InputError, match="expected at least 2 anchors"):
        anchor_graph(BAR[:1], torch.zeros(1, 1))
    with pytest.raises(EditError, match="expected a count of at least 2, got 1"):
        rig_of(BAR, count=1)
    with pytest.raises(EditError, match="expected at least 601 points to choose from, got 600"):
        rig_of(BAR, count=601)


# --- dragging -----------------------------------------------------------------------------------


def test_held_anchors_are_where_they_are_put_and_far_ones_do_not_move() -> None:
    target = torch.tensor([0.9, 0.4, 0.3])
    pose = drag(RIG.graph, {RIGHT: Handle(place=target)}, reach=0.7)
    torch.testing.assert_close(pose.moved[RIGHT], target)
    still = RIG.graph.between[:, RIGHT] > 0.7
    assert 0 < int(still.sum()) < 39
    assert torch.equal(pose.moved[still], RIG.graph.rest[still])
    assert torch.equal(pose.rotations[still], torch.eye(3).expand(int(still.sum()), 3, 3))
    assert ((pose.moved - pose.rest)[~still].norm(dim=1) > 0).all()


def test_one_handle_without_end_of_reach_carries_everything_along() -> None:
    shift = torch.tensor([0.3, -2.0, 1.0])
    place = RIG.graph.rest[LEFT] + shift
    pose = drag(RIG.graph, {LEFT: Handle(place=place)}, reach=math.inf)
    torch.testing.assert_close(pose.moved, pose.rest + shift, atol=1e-5, rtol=0)
    torch.testing.assert_close(pose.rotations, torch.eye(3).expand(40, 3, 3), atol=1e-5, rtol=0)


def test_a_turned_handle_turns_everything() -> None:
    motion = rigid("x", 0.8)
    turned = Handle(place=motion(RIG.graph.rest[LEFT]), rotation=motion.matrix)
    pose = drag(RIG.graph, {LEFT: turned}, reach=math.inf)
    assert torch.equal(pose.rotations[LEFT], motion.matrix.float())
    torch.testing.assert_close(pose.moved, motion(pose.rest), atol=1e-5, rtol=0)


def test_lengths_are_kept_as_well_as_they_can_be() -> None:
    """A bar bent by its ends: links change their length far less than a linear blend makes them."""
    ends = {
        LEFT: Handle(place=torch.tensor([-0.5, 0.0, 0.7])),
        RIGHT: Handle(place=torch.tensor([0.5, 0.0, 0.7])),
    }
    pose = drag(RIG.graph, ends, reach=math.inf)
    first, second = RIG.graph.links.unbind(dim=1)

    def strain(places: torch.Tensor) -> torch.Tensor:
        now, before = ((p[first] - p[second]).norm(dim=1) for p in (places, pose.rest))
        return ((now - before).abs() / before).mean()

    share = (pose.rest[:, :1] + 1) / 2
    blend = pose.rest + (
        (1 - share) * (ends[LEFT].place - pose.rest[LEFT])
        + share * (ends[RIGHT].place - pose.rest[RIGHT])
    )
    assert strain(pose.moved) < 0.6 * strain(blend)


def test_a_rope_is_not_twisted_by_chance() -> None:
    """Anchors on a line leave the turn about it open: none is taken."""
    line = torch.linspace(-1, 1, 300)
    rope = torch.stack([line, 0 * line, 0 * line], dim=1)
    rig = rig_of(rope, count=20)
    end, other = int(rig.graph.rest[:, 0].argmax()), int(rig.graph.rest[:, 0].argmin())
    held = {
        end: Handle(place=torch.tensor([0.8, 0.0, 0.5])),
        other: Handle(place=rig.graph.rest[other]),
    }
    for pose in (
        drag(rig.graph, held, reach=math.inf),
        pose_from_places(rig.graph, rig.graph.rest * torch.tensor([0.9, 1.0, 1.0])),
    ):
        # The bend is in the plane of x and z, so y stays where it is.
        across = pose.rotations[:, :, 1]
        torch.testing.assert_close(
            across, torch.tensor([0.0, 1.0, 0.0]).expand(20, 3), atol=1e-4, rtol=0
        )


def test_a_drag_to_where_it_is_changes_nothing() -> None:
    held = {RIGHT: Handle(place=RIG.graph.rest[RIGHT]), LEFT: Handle(place=RIG.graph.rest[LEFT])}
    moved = RIG.deformation(drag(RIG.graph, held, reach=math.inf))(BAR)
    assert torch.equal(moved, BAR)


def test_one_factorisation_serves_many_places() -> None:
    dragger = Dragger(RIG.graph, (RIGHT,), reach=1.0)
    for z in (0.1, 0.4):
        held = {RIGHT: Handle(place=torch.tensor([1.0, 0.0, z]))}
        assert torch.equal(dragger.pose(held).moved, drag(RIG.graph, held, reach=1.0).moved)


def test_a_reach_that_frees_no_other_anchor() -> None:
    pose = drag(RIG.graph, {RIGHT: Handle(place=torch.ones(3))}, reach=1e-6)
    assert int(((pose.moved - pose.rest).norm(dim=1) > 0).sum()) == 1


def test_bad_drags() -> None:
    place = Handle(place=torch.zeros(3))
    with pytest.raises(EditError, match="an anchor from 0 to 39, got 40"):
        drag(RIG.graph, {40: place}, reach=1.0)
    with pytest.raises(EditError, match=r"at least one handle .* got none"):
        drag(RIG.graph, {}, reach=1.0)
    with pytest.raises(EditError, match="expected a reach above 0, got 0"):
        drag(RIG.graph, {1: place}, reach=0.0)
    with pytest.raises(EditError, match="expected a finite place of anchor 1"):
        drag(RIG.graph, {1: Handle(place=torch.full((3,), torch.nan))}, reach=1.0)
    with pytest.raises(EditError, match=r"places of the handles \[1\], got \[2\]"):
        Dragger(RIG.graph, (1,), reach=1.0).pose({2: place})


# --- the edit -----------------------------------------------------------------------------------


def test_the_edit_moves_its_anchor_and_leaves_the_far_end() -> None:
    deformation = AnchorsEdit.model_validate(handles()).bind(BAR)
    moved = deformation(BAR)
    anchor = RIG.graph.rest[RIGHT]
    at_anchor = deformation(anchor[None])[0]
    assert float((at_anchor - torch.tensor([1, 0, 0.5])).norm()) < 0.15
    left = BAR[:, 0] < -0.3
    assert torch.equal(moved[left], BAR[left])
    assert not torch.equal(moved, BAR)


def test_a_place_names_the_nearest_anchor_and_shifts_it() -> None:
    near = (RIG.graph.rest[RIGHT] + torch.tensor([0.02, 0.01, 0.0])).tolist()
    by_place = AnchorsEdit.model_validate(
        handles(handles=[{"near": near, "to": [near[0], near[1], near[2] + 0.5]}])
    )
    found = by_place.placed(RIG)
    assert list(found) == [RIGHT]
    shifted = RIG.graph.rest[RIGHT] + torch.tensor([0.0, 0.0, 0.5])
    torch.testing.assert_close(found[RIGHT].place, shifted)


def test_a_place_survives_other_anchors() -> None:
    """On another sampling of the same object the same file moves the surface by the same field."""
    entry = handles(handles=[{"near": [1, 0, 0], "to": [0.9, 0, 0.4]}], reach=1.0)
    edit = AnchorsEdit.model_validate(entry)
    here, there = edit.bind(BAR), edit.bind(bar(900))
    probe = torch.stack([torch.linspace(-1, 1, 50), torch.zeros(50), torch.zeros(50)], dim=1)
    difference = (here(probe) - there(probe)).norm(dim=1)
    assert difference.mean() < 0.1 * 0.41


def test_the_point_nearest_to_the_place_is_held_itself() -> None:
    points = bar()
    near = points[points[:, 0].argmax()]
    target = near + torch.tensor([0.0, 0.0, 0.3])
    entry = {"type": "anchors", "handles": [{"near": near.tolist(), "to": target.tolist()}]}
    for count in (16, 17, 64):
        edit = AnchorsEdit.model_validate({**entry, "count": count})
        moved = edit.bind(points)(near[None])[0]
        # Its own anchor weighs nearly all; the seed's anchors are up to a spacing away.
        assert (moved - target).norm() < 0.01 * 0.3


def test_a_handle_that_stays_where_it_is_changes_little_elsewhere() -> None:
    points = bar()
    left, right = points[points[:, 0].argmin()], points[points[:, 0].argmax()]
    drag_right = {"near": right.tolist(), "to": (right + torch.tensor([0.0, 0.0, 0.3])).tolist()}
    pin = {"near": left.tolist(), "to": left.tolist()}
    alone, pinned = (
        AnchorsEdit.model_validate({"type": "anchors", "handles": some, "count": 40, "reach": 0.6})
        for some in ([drag_right], [drag_right, pin])
    )
    before, after = alone.bind(points)(points), pinned.bind(points)(points)
    assert (before - after).norm(dim=1).max() < 0.02 * 0.3


def test_two_handles_at_one_point_are_refused_and_two_beside_each_other_are_not() -> None:
    points = bar()
    first, second = points[0].tolist(), points[torch.cdist(points[:1], points)[0].argsort()[1]]
    to = [0.0, 0.0, 1.0]
    same = [{"near": first, "to": to}, {"near": first, "to": to}]
    with pytest.raises(EditError, match="an anchor of its own"):
        AnchorsEdit.model_validate({"type": "anchors", "handles": same}).bind(points)
    beside = [{"near": first, "to": first}, {"near": second.tolist(), "to": second.tolist()}]
    edit = AnchorsEdit.model_validate({"type": "anchors", "handles": beside})
    assert (edit.bind(points)(points) - points).abs().max() < 1e-5


def test_places_are_measured_from_the_origin() -> None:
    near, to = torch.tensor([1.0, 0, 0]), torch.tensor([0.9, 0, 0.4])
    origin = torch.tensor([0.5, 0.25, -1.0])
    plain = handles(handles=[{"near": near.tolist(), "to": to.tolist()}])
    moved = plain | {
        "origin": origin.tolist(),
        "handles": [{"near": (near - origin).tolist(), "to": (to - origin).tolist()}],
    }
    here, there = (AnchorsEdit.model_validate(one).bind(BAR)(BAR) for one in (plain, moved))
    torch.testing.assert_close(here, there, atol=1e-6, rtol=0)


def test_a_handle_may_carry_a_rotation() -> None:
    entry = {"anchor": RIGHT, "to": RIG.graph.rest[RIGHT].tolist(), "axis": "x", "angle_deg": 90}
    pose = AnchorsEdit.model_validate(handles(handles=[entry])).bind(BAR).pose
    expected = rigid("x", math.pi / 2).matrix.float()
    torch.testing.assert_close(pose.rotations[RIGHT], expected)


def test_learned_weights_can_take_the_place_of_distances() -> None:
    distance = path_distance(BAR, farthest_points(BAR, 40))
    rig = rig_with(distance, distance_weigher(distance, sigma=1.0))
    edit = AnchorsEdit.model_validate(handles())
    assert not torch.equal(edit.bind_to(rig)(BAR), edit.bind(BAR)(BAR))
    assert torch.equal(edit.bind_to(RIG)(BAR), edit.bind(BAR)(BAR))


def test_bad_handles_of_a_cloud() -> None:
    def bind(*entries: dict) -> None:
        AnchorsEdit.model_validate(handles(handles=list(entries))).bind(BAR)

    with pytest.raises(EditError, match="handle 1: expected an anchor from 0 to 39, got 40"):
        bind({"anchor": 40, "to": [0, 0, 0]})
    with pytest.raises(EditError, match=r"handle 1: expected a place on the object, got .*units"):
        bind({"near": [50, 0, 0], "to": [0, 0, 0]})
    with pytest.raises(EditError, match=f"handle 2: .* got anchor {RIGHT} twice"):
        bind({"anchor": RIGHT, "to": [0, 0, 0]}, {"near": [1, 0, 0], "to": [0, 0, 1]})


@pytest.mark.parametrize(
    "wrong",
    [
        {"handles": []},
        {"handles": [{"to": [0, 0, 0]}]},
        {"handles": [{"anchor": 1, "near": [0, 0, 0], "to": [0, 0, 0]}]},
        {"handles": [{"anchor": -1, "to": [0, 0, 0]}]},
        {"handles": [{"anchor": 1, "to": [0, 0, math.nan]}]},
        {"handles": [{"anchor": 1, "to": [0, 0, 0], "angle_deg": 30}]},
        {"handles": [{"anchor": 1, "to": [0, 0, 0], "wheel": 3}]},
        {"reach": 0},
        {"count": 1},
        {"seed": -1},
    ],
)
def test_bad_entries_are_refused(wrong: dict) -> None:
    with pytest.raises(ValidationError):
        AnchorsEdit.model_validate(handles(**wrong))


def test_it_reads_back_as_it_was_written() -> None:
    edit = AnchorsEdit.model_validate(handles(reach=0.5))
    assert AnchorsEdit.model_validate_json(edit.model_dump_json()) == edit


# --- the bars, on a real cloud --------------------------------------------------------------------


def test_what_is_wrong_with_a_handle_is_said_by_name() -> None:
    good = {"near": [0, 0, 0], "to": [0, 0, 1]}

    def said(**change: object) -> str:
        content = {"type": "anchors", "handles": [good, {**good, **change}]}
        with pytest.raises(EditError) as caught:
            parse_edit({"version": 2, "edits": [content]})
        return str(caught.value)

    place = 'edit 1 (anchors): key "handles", number 2: '
    assert (
        place + 'unknown key "angel_deg" for a handle, expected only "anchor", "near", "to", "a'
        in (said(angel_deg=30))
    )
    text = said(anchor=3)
    assert place + 'expected either "anchor" (its number) or "near" (a place [x, y, z])' in text
    assert text.endswith("got both")
    assert said(near=None).endswith("got neither")
    assert place + 'key "to": expected three finite numbers [x, y, z], got [1, 2]' in said(
        to=[1, 2]
    )
    assert said(to=["a", "b", 1]).count('key "to"') == 1
    assert 'key "anchor": expected the number of an anchor, from 0, got -1' in said(
        near=None, anchor=-1
    )
    assert 'needs an "axis" to turn about, got none' in said(angle_deg=30)
    text = said(angel_deg=30, to=[1, 2])
    assert 'unknown key "angel_deg"' in text
    assert 'key "to"' in text


END = [1.0, 0.0, 0.0]


def test_a_share_of_a_drag_is_a_drag_by_a_share_of_the_way() -> None:
    points = BAR
    handle = {"near": END, "to": [h + 0.2 for h in END], "axis": "z", "angle_deg": 40}
    half = {"near": END, "to": [h + 0.1 for h in END], "axis": "z", "angle_deg": 20}

    def moved(handle: dict, **more: object) -> torch.Tensor:
        edit = {"type": "anchors", "handles": [handle], "count": 40, **more}
        return parse_edit({"version": 2, "edits": [edit]}).bind(points)(points)

    torch.testing.assert_close(moved(handle, amount=0.5), moved(half), rtol=0, atol=1e-5)
    assert torch.equal(moved(handle, amount=0), points)
    assert torch.equal(moved(handle, amount=1.0), moved(handle))
    assert not torch.equal(moved(handle), points)


@pytest.fixture
def cloud(shared_data: Path) -> torch.Tensor:
    """30,000 points of the knight's visible surface."""
    root = shared_data / "deformed" / "knight"
    samples = load_samples(root).positions(load_truth(root), None)
    chosen = torch.randperm(len(samples), generator=torch.Generator().manual_seed(0))[:30_000]
    return torch.from_numpy(samples)[chosen].float()


def test_a_hand_of_the_knight_moves_alone_and_fast(cloud: torch.Tensor) -> None:
    began = time.process_time()
    rig = rig_of(cloud)
    binding = time.process_time() - began
    hand = int(rig.graph.rest[:, 0].argmin())
    dragger = Dragger(rig.graph, (hand,), reach=0.25 * rig.size)
    times: list[float] = []
    for lift in (0.1, 0.3, 0.5, 0.7):
        began = time.process_time()
        place = rig.graph.rest[hand] + torch.tensor([0.1, -0.3, lift])
        moved = rig.deformation(dragger.pose({hand: Handle(place=place)}))(cloud)
        times.append(time.process_time() - began)
    motion = (moved - cloud).norm(dim=1)
    far = (cloud - rig.graph.rest[hand]).norm(dim=1) > 0.4 * rig.size
    assert int(far.sum()) > 1000
    assert float(motion[far].max()) <= 0.01 * rig.size
    assert float(motion.max()) > 0.5
    # The bars, in time of the processor, so that other work on the machine does not count.
    assert binding < 10
    assert min(times) < 0.03


@pytest.mark.parametrize(
    "handle",
    [
        {"anchor": 1},
        {"near": [0, 0], "to": [0, 0, 1]},
        {"anchor": 1, "to": [0, 0, 1], "angle_deg": 3},
        {"anchor": 1, "to": [0, 0, 1], "color": 1},
    ],
)
def test_one_wrong_handle_is_one_message(handle: dict):
    with pytest.raises(EditError, match='key "handles", number 1: ') as caught:
        parse_edit({"version": 2, "edits": [{"type": "anchors", "handles": [handle]}]})
    assert "a list of handles" not in str(caught.value)


def test_a_place_beyond_all_numbers_is_said_as_it_is():
    edit = {"type": "anchors", "handles": [{"anchor": 1, "to": [1e300, 0, 0]}]}
    points = torch.rand(300, 3, generator=torch.Generator().manual_seed(0))
    with pytest.raises(EditError, match=r"a finite place of anchor 1, got \[inf, 0.0, 0.0\]"):
        parse_edit({"version": 2, "edits": [edit]}).bind(points)

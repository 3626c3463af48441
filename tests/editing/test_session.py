"""A session: every command makes a state or changes nothing."""

import json
from pathlib import Path

import pytest
import torch

from pcore.deform.pose import pose
from pcore.editing import anchors
from pcore.editing.script import load_edit, parse_one
from pcore.editing.session import EditSession
from pcore.errors import EditError
from pcore.geometry.point_cloud import PointCloud

TWIST = {"type": "twist", "axis": "z", "angle_deg": 40}
SHIFT = {"type": "rigid", "translation": [0, 0, 0.1]}
FEET = {"shape": "half_space", "origin": [0, 0, -0.3], "normal": [0, 0, -1], "falloff": 0.3}


def cloud() -> torch.Tensor:
    return torch.rand(300, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def session(*edits: dict) -> EditSession:
    made = EditSession(cloud())
    for edit in edits:
        made.do(edit)
    return made


def test_doing_and_undoing():
    made = session()
    before = made.state
    assert torch.equal(before.points, cloud())
    first = made.do(TWIST)
    second = made.do(parse_one(SHIFT))
    assert [edit.type for edit in second.script.edits] == ["twist", "rigid"]
    assert not torch.equal(first.points, second.points)
    assert made.undo() is first
    assert made.undo() is before
    assert not made.can_undo
    assert made.redo() is first
    assert made.redo() is second
    assert not made.can_redo


def test_doing_something_else_forgets_what_was_undone():
    made = session(TWIST, SHIFT)
    made.undo()
    made.do({**SHIFT, "translation": [1, 0, 0]})
    assert not made.can_redo
    with pytest.raises(EditError, match="redo: expected a command that was undone, got none"):
        made.redo()


def test_there_must_be_something_to_undo():
    with pytest.raises(EditError, match="undo: expected a command to take back, got none"):
        session().undo()


def test_a_preview_changes_nothing():
    made = session(TWIST)
    now = made.state
    shown = made.preview(SHIFT)
    assert made.state is now
    assert torch.equal(shown.points, made.do(SHIFT).points)


def test_freezing_holds_what_was_done_before_too():
    made = session(SHIFT, {**SHIFT, "translation": [0.1, 0, 0]})
    state = made.freeze(FEET)
    low = cloud()[:, 2] <= -0.3
    assert torch.equal(state.points[low], cloud()[low])
    after = made.do(TWIST)
    assert torch.equal(after.points[low], cloud()[low])
    high = cloud()[:, 2] > 0
    assert float((after.points - cloud())[high].norm(dim=-1).min()) > 0.05
    free = made.freeze()
    assert not torch.equal(free.points[low], cloud()[low])
    made.undo()
    assert made.undo() is state


@pytest.mark.parametrize("freeze", [(), (FEET,)])
def test_replaying_a_saved_file_gives_the_same_points_bit_for_bit(tmp_path: Path, freeze):
    made = session(TWIST, SHIFT, {**TWIST, "region": FEET})
    made.freeze(*freeze)
    made.do({**SHIFT, "translation": [0, 0.1, 0]})
    made.save(tmp_path / "edit.json")
    script = load_edit(tmp_path / "edit.json")
    assert script == made.state.script
    again = script.bind(cloud())(cloud().double()).float()
    assert torch.equal(again, made.state.points)
    other = EditSession(cloud())
    assert torch.equal(other.load(tmp_path / "edit.json").points, made.state.points)
    assert torch.equal(EditSession(cloud(), script).state.points, made.state.points)
    assert torch.equal(other.undo().points, cloud())


def test_the_deformation_of_a_state_carries_other_places():
    state = session(TWIST, SHIFT).state
    places = cloud()[:10] + 0.01
    expected = state.script.bind(cloud())(places)
    assert torch.equal(state.deformation(places), expected)


def test_points_that_are_changed_outside_are_not_the_sessions():
    points = cloud()
    made = EditSession(points)
    points += 1
    assert torch.equal(made.canonical, cloud())
    made.canonical.add_(1)
    assert torch.equal(made.state.points, cloud())


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        ({"type": "shear"}, 'edit: key "type": expected one of'),
        ({**TWIST, "angle_deg": float("nan")}, 'key "angle_deg": expected a finite number of'),
        ({**SHIFT, "region": {**FEET, "origin": [0, 0, -9]}}, "edit 2 (rigid): empty region"),
        ({"type": "bend", "axis": "z", "angle_deg": 300}, "edit 2 (bend): singular deformation"),
        ({**SHIFT, "region": {"shape": "points", "ids": [300]}}, "numbers from 0 to 299"),
    ],
)
def test_a_bad_edit_leaves_the_session_as_it_was(edit: dict, expected: str):
    made = session(TWIST, SHIFT)
    made.undo()
    now = made.state
    # A preview does not look for folds.
    commands = (made.do,) if "singular" in expected else (made.do, made.preview)
    for command in commands:
        with pytest.raises(EditError) as caught:
            command(edit)
        assert expected in str(caught.value)
        assert made.state is now
        assert made.can_redo


def test_a_preview_shows_a_fold_and_a_picture_of_it_is_refused():
    made = session(TWIST)
    bend = {"type": "bend", "axis": "z", "angle_deg": 300}
    shown = made.preview(bend)
    assert bool(torch.isfinite(shown.points).all())
    papr_cloud = PointCloud(
        positions=cloud(), features=torch.zeros(300, 2), influence=torch.zeros(300)
    )
    with pytest.raises(EditError, match="singular deformation"):
        pose(papr_cloud, shown.deformation)
    with pytest.raises(EditError, match="singular deformation"):
        made.do(bend)


def test_a_file_with_keyframes_is_loaded_at_a_time(tmp_path: Path):
    path, made = tmp_path / "edit.json", session(TWIST)
    track = {"keyframes": [[1, 1], [3, 2]]}
    path.write_text(json.dumps({"version": 2, "edits": [{"type": "scale", "factor": track}]}))
    now = made.state
    state = made.load(path, time=2)
    torch.testing.assert_close(state.points, 1.5 * cloud())
    assert made.undo() is now
    assert made.load(path, time=0).script.edits[0].factor == 1


def test_a_bad_freeze_or_file_leaves_the_session_as_it_was(tmp_path: Path):
    made = session(TWIST)
    now = made.state
    with pytest.raises(EditError, match="freeze: empty region"):
        made.freeze({**FEET, "origin": [0, 0, -9]})
    with pytest.raises(EditError, match="expected one of"):
        made.freeze({"shape": "cone"})
    with pytest.raises(EditError, match="edit file not found"):
        made.load(tmp_path / "none.json")
    with pytest.raises(EditError, match="expected an existing folder"):
        made.save(tmp_path / "none" / "edit.json")
    assert made.state is now


def test_a_second_drag_of_an_anchor_measures_no_path_again(monkeypatch: pytest.MonkeyPatch):
    calls: list[int] = []
    whole = anchors.path_distance

    def counting(points: torch.Tensor, indices: torch.Tensor):
        calls.append(len(points))
        return whole(points, indices)

    monkeypatch.setattr(anchors, "path_distance", counting)
    anchors._rig.cache_clear()
    made = EditSession(cloud())
    for step in (0.1, 0.2, 0.3):
        handle = {"near": [0.4, 0, 0], "to": [0.4, 0, step]}
        edit = {"type": "anchors", "count": 20, "handles": [handle]}
        shown = made.preview(edit)
    assert calls == [300]
    assert torch.equal(made.do(edit).points, shown.points)
    assert calls == [300]


def test_many_edits_are_the_one_that_means_the_same_in_points_and_frames():
    """Points and frames are all that a picture takes from an edit."""
    once, often = session({**TWIST, "angle_deg": 120}), session()
    for _ in range(24):
        often.do({**TWIST, "angle_deg": 5})
    whole = PointCloud(positions=cloud(), features=torch.zeros(300, 2), influence=torch.zeros(300))
    one, many = (pose(whole, made.state.deformation) for made in (once, often))
    torch.testing.assert_close(many.positions, one.positions, rtol=0, atol=1e-6)
    assert one.local_maps is not None
    assert many.local_maps is not None
    torch.testing.assert_close(many.local_maps.to_rest, one.local_maps.to_rest, rtol=0, atol=1e-5)
    assert float((one.positions - cloud()).norm(dim=1).max()) > 0.3

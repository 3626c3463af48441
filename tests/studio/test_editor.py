"""The page without a page: what its commands do to the edits and to what is shown."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from objects import TWIST, demo

from pcore.editing.stack import raw_edit
from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of
from pcore.studio.edit_forms import CHOICES, NEW, SLIDERS, SOFT, value_at
from pcore.studio.editor import Editor
from pcore.studio.handle_pose import HandlePose


@pytest.fixture
def editor() -> Editor:
    return Editor(demo())


def pulled(editor: Editor, by: float = 0.1) -> HandlePose:
    """A handle on the highest point, shown somewhat higher."""
    editor.place_handle(int(editor.asset.points[:, 2].argmax()))
    x, y, z = editor.handles[0].place
    return HandlePose(place=(x, y, z + by))


def edits(editor: Editor) -> list[dict[str, Any]]:
    return [raw_edit(entry) for entry in editor.session.stack.edits]


@pytest.mark.parametrize("kind", NEW)
def test_a_new_edit_changes_nothing_and_its_sliders_do(editor: Editor, kind: str) -> None:
    editor.add(kind)
    rest = editor.asset.points
    assert torch.allclose(editor.state.points, rest, atol=1e-6)
    first = SLIDERS[kind][0]
    assert value_at(editor.raw(0), first) == first.rest
    editor.set(0, first.path, first.rest + 10 * first.step)
    assert not torch.allclose(editor.state.points, rest, atol=1e-3)
    editor.undo()
    assert torch.allclose(editor.state.points, rest, atol=1e-6)


@pytest.mark.parametrize("kind", NEW)
def test_every_slider_and_choice_of_a_kind_is_one_of_its_edits(editor: Editor, kind: str) -> None:
    editor.add(kind)
    for slider in SLIDERS[kind]:
        editor.set(0, slider.path, slider.rest)
    for path, names in CHOICES.get(kind, {}).items():
        for name in names:
            editor.set(0, path, name)


def test_a_handle_is_placed_dragged_and_dropped_as_one_step(editor: Editor) -> None:
    goal = pulled(editor)
    depth = editor.session.history.now
    x, y, z = goal.place
    for share in (0.2, 0.6, 1.0):
        editor.drag(HandlePose(place=(x, y, z - 0.1 * (1 - share))))
    assert editor.dragging
    shown = editor.state.points.clone()
    assert editor.drop()
    assert editor.session.history.now == depth + 1
    assert torch.equal(editor.state.points, shown)
    assert editor.handles[0].place == pytest.approx(goal.place, abs=1e-6)
    top = int(editor.asset.points[:, 2].argmax())
    assert editor.state.points[top].tolist() == pytest.approx(goal.place, abs=5e-3)
    editor.undo()
    assert torch.allclose(editor.state.points, editor.asset.points, atol=1e-5)


def test_escape_puts_a_dragged_handle_back(editor: Editor) -> None:
    editor.drag(pulled(editor))
    editor.cancel()
    assert not editor.dragging
    assert torch.allclose(editor.state.points, editor.asset.points, atol=1e-5)
    assert editor.drop(), "nothing is held any more"


def test_what_folds_is_shown_and_not_kept(editor: Editor) -> None:
    heights = editor.asset.points[:, 2]
    editor.choose(heights < heights.median())
    editor.freeze()
    editor.place_handle(int((heights - heights.median() - 0.08).abs().argmin()))
    x, y, z = editor.handles[0].place
    goal = HandlePose(place=(x, y, z - 0.02))
    editor.drag(goal)
    assert not len(editor.state.folds)
    assert editor.back == ""
    editor.drag(HandlePose(place=(x, y, z - 0.8)))
    assert editor.back == "0.78", "as far as from the last place without a fold"
    assert len(editor.state.folds), "what is pushed through what is held folds"
    assert editor.state.rays == "plain"
    assert not editor.drop()
    assert editor.handles[0].place == pytest.approx(goal.place, abs=1e-6)
    assert not len(editor.state.folds)


def test_handles_go_into_one_edit_until_another_is_selected(editor: Editor) -> None:
    for point in (10, 500, 900):
        editor.place_handle(point)
    assert [len(one["handles"]) for one in edits(editor)] == [3]
    with pytest.raises(EditError, match="at this very place"):
        editor.place_handle(500)
    editor.select(None)
    editor.place_handle(500)
    assert [len(one["handles"]) for one in edits(editor)] == [3, 1]
    editor.remove_handle()
    assert [len(one["handles"]) for one in edits(editor)] == [3]


def test_a_turned_handle_comes_back_as_it_was_turned(editor: Editor) -> None:
    place = pulled(editor, 0.0).place
    turn = (0.9659258, 0.0, 0.2588190, 0.0)
    editor.drag(HandlePose(place=place, turn=turn))
    editor.drop()
    assert editor.handles[0].turn == pytest.approx(turn, abs=1e-6)
    assert edits(editor)[0]["handles"][0]["rotation"] == pytest.approx(turn, abs=1e-6)


def test_handles_move_in_pairs_across_a_mirror(editor: Editor) -> None:
    points = editor.asset.points
    middle = float(points[:, 1].amin() + points[:, 1].amax()) / 2
    editor.shown = replace(editor.shown, mirror="y")
    editor.place_handle(int((points[:, 1] - middle).abs().argmax()))
    first, second = editor.handles
    assert first.place[1] - middle == pytest.approx(middle - second.place[1], abs=0.1)
    x, y, z = first.place
    editor.drag(HandlePose(place=(x, y + 0.1, z + 0.05)))
    editor.drop()
    moved = editor.handles[1].place
    assert moved[1] == pytest.approx(second.place[1] - 0.1, abs=1e-6)
    assert moved[2] == pytest.approx(second.place[2] + 0.05, abs=1e-6)
    editor.undo()
    assert editor.handles[1].place == pytest.approx(second.place, abs=1e-6)


def test_a_handle_of_an_earlier_edit_moves_on_the_object(editor: Editor) -> None:
    goal = pulled(editor, 0.0)
    editor.add("rigid")
    editor.set(1, "translation/0", 0.5)
    editor.select(0)
    editor.select_handle(0)
    shown = editor.handles[0].place
    assert shown[0] == pytest.approx(goal.place[0] + 0.5, abs=1e-5)
    editor.drag(HandlePose(place=(shown[0], shown[1], shown[2] + 0.05)))
    editor.drop()
    assert editor.handles[0].place[2] == pytest.approx(shown[2] + 0.05, abs=5e-3)


def test_a_slider_is_one_step_and_the_next_gesture_another(editor: Editor) -> None:
    editor.add("twist")
    depth = editor.session.history.now
    for angle in range(1, 20):
        editor.set(0, "angle_deg", float(angle))
    assert editor.session.history.now == depth + 1
    editor.begin()
    editor.set(0, "angle_deg", 30.0)
    assert editor.session.history.now == depth + 2
    editor.undo()
    assert editor.raw(0)["angle_deg"] == 19.0


def test_the_stack_is_moved_doubled_and_emptied(editor: Editor) -> None:
    editor.add("twist")
    editor.add("bend")
    editor.move(1, -1)
    assert [one["type"] for one in edits(editor)] == ["bend", "twist"]
    assert editor.shown.selected == 0
    editor.move(0, -1)
    editor.duplicate(1)
    assert [one["type"] for one in edits(editor)] == ["bend", "twist", "twist"]
    for _ in range(3):
        editor.remove(0)
    assert editor.shown.selected is None
    while editor.session.can_undo:
        editor.undo()
    assert edits(editor) == []
    assert torch.equal(editor.state.points, editor.asset.points)


def test_a_selection_is_frozen_and_let_go(editor: Editor) -> None:
    low = editor.asset.points[:, 2] < editor.asset.points[:, 2].median()
    with pytest.raises(EditError, match="with Shift held"):
        editor.freeze()
    editor.choose(low)
    editor.freeze()
    assert not editor.shown.chosen
    editor.add("rigid")
    editor.set(0, "translation/2", 0.02)
    moved = (editor.state.points - editor.asset.points).norm(dim=1)
    assert float(moved[low].max()) < 1e-6
    assert float(moved[~low].max()) > 0.015
    with pytest.raises(EditError, match="frozen"):
        editor.place_handle(int(low.nonzero()[0]))
    editor.thaw()
    assert float((editor.state.points - editor.asset.points).norm(dim=1)[low].min()) > 0.015


def test_selections_add_subtract_and_invert(editor: Editor) -> None:
    first = torch.zeros(len(editor.asset.points), dtype=torch.bool)
    first[:10] = True
    editor.choose(first)
    second = torch.zeros_like(first)
    second[5:15] = True
    editor.choose(second, how="add")
    assert len(editor.shown.chosen) == 15
    editor.choose(first, how="subtract")
    assert editor.shown.chosen == frozenset(range(10, 15))
    editor.invert()
    assert len(editor.shown.chosen) == len(first) - 5
    editor.invert()
    editor.add("rigid")
    editor.set(0, "translation/2", 0.02)
    assert edits(editor)[0]["region"]["ids"] == list(range(10, 15))
    editor.choose(torch.zeros_like(first))
    editor.limit(0)
    assert "region" not in edits(editor)[0]


def test_keys_are_set_where_a_slider_is_moved(editor: Editor) -> None:
    editor.add("twist")
    editor.set(0, "angle_deg", 10.0)
    editor.key(0, "smooth")
    editor.at(1.0)
    editor.set(0, "angle_deg", 40.0)
    assert editor.key_times == [0.0, 1.0]
    editor.at(0.0)
    assert editor.raw(0)["angle_deg"] == pytest.approx(10.0)
    editor.at(0.5)
    assert 10 < editor.raw(0)["angle_deg"] < 40
    editor.at(1.0)
    editor.unkey(0)
    assert editor.key_times == [0.0]


@pytest.mark.parametrize("kind", NEW)
def test_a_key_keys_every_number_of_the_form_and_changes_nothing(editor: Editor, kind: str) -> None:
    soft = () if kind == "stretch" else (SOFT,)  # Half an object that is stretched folds.
    if soft:
        editor.choose(editor.asset.points[:, 2] > editor.asset.points[:, 2].median())
    editor.add(kind)
    first, *others = SLIDERS[kind]
    editor.set(0, first.path, first.rest + 2 * first.step)
    before, depth = editor.state.points.clone(), editor.session.history.now
    editor.key(0, "smooth")
    assert editor.session.history.now == depth + 1
    assert torch.equal(editor.state.points, before)
    editor.at(1.0)
    for slider in (*others, *soft):
        one = slider.scaled(size_of(editor.asset.points))
        by = one.step if slider is SOFT or not one.rest else -one.step
        editor.set(0, one.path, value_at(editor.raw(0), one) + by)
    there = editor.state.points.clone()
    assert not torch.equal(there, before)
    editor.at(0.0)
    editor.refine()
    assert torch.equal(editor.state.points, before), "no other time reads anything else"
    editor.at(1.0)
    assert torch.equal(editor.state.points, there)


def test_numbers_of_a_vector_may_have_keys_of_their_own(editor: Editor) -> None:
    track = {"keyframes": [[0, 0.0], [1, 0.4]]}
    editor.session.do({"type": "rigid", "translation": [track, 0.1, 0.0]})
    editor.select(0)
    editor.at(1.0)
    editor.set(0, "translation/1", 0.3)
    editor.set(0, "translation/0", 0.5)
    assert editor.raw(0)["translation"] == pytest.approx([0.5, 0.3, 0.0])
    editor.at(0.5)
    editor.key(0)
    assert editor.raw(0)["translation"] == pytest.approx([0.25, 0.3, 0.0])
    x, y, z = editor.handles[0].place
    editor.at(1.0)
    editor.drag(HandlePose(place=(x + 1.0, y, z)))
    editor.drop()
    assert editor.raw(0)["translation"][0] == pytest.approx(1.25)
    editor.at(0.0)
    assert editor.raw(0)["translation"] == pytest.approx([0.0, 0.3, 0.0])


def test_what_is_turned_at_one_time_is_not_at_another(editor: Editor) -> None:
    place = pulled(editor).place
    editor.key(0)
    editor.at(1.0)
    editor.drag(HandlePose(place=place, turn=(0.9659258, 0.0, 0.2588190, 0.0)))
    editor.drop()
    assert editor.handles[0].turn == pytest.approx((0.9659258, 0.0, 0.2588190, 0.0))
    editor.at(0.0)
    assert editor.handles[0].turn == (1.0, 0.0, 0.0, 0.0)


def test_while_time_goes_by_frames_are_quick_and_exact_once_it_rests(tmp_path: Path) -> None:
    editor = Editor(demo(), TWIST)
    editor.at(0.4)
    quick = editor.state
    assert quick is editor.state
    assert editor.raw(0)["angle_deg"] == pytest.approx(20.0)
    editor.refine()
    assert editor.state is editor.session.state
    assert editor.state is not quick
    assert torch.equal(editor.state.points, quick.points)
    editor.at(0.6)
    editor.set(0, "angle_deg", 11.0)
    assert editor.raw(0)["angle_deg"] == 11.0, "a command is shown, whatever went by before"


def test_a_handle_with_keys_is_keyed_where_it_is_dropped(editor: Editor) -> None:
    goal = pulled(editor)
    editor.key(0)
    editor.at(1.0)
    editor.drag(goal)
    editor.drop()
    assert editor.key_times == [0.0, 1.0]
    assert editor.handles[0].place == pytest.approx(goal.place, abs=1e-6)
    editor.at(0.0)
    assert editor.handles[0].place[2] == pytest.approx(goal.place[2] - 0.1, abs=1e-6)


def test_saved_edits_are_the_same_object_bit_for_bit(editor: Editor, tmp_path: Path) -> None:
    editor.drag(pulled(editor))
    editor.drop()
    editor.add("twist")
    editor.set(1, "angle_deg", 25.0)
    path = tmp_path / "edit.json"
    editor.session.save(path)
    assert torch.equal(demo().pose(path).points, editor.state.points)
    assert torch.equal(Editor(demo(), path).state.points, editor.state.points)


def test_it_begins_with_an_edit_file_with_keyframes(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    path.write_text(json.dumps(TWIST))
    editor = Editor(demo(), path)
    assert editor.shown.selected == 0
    assert editor.key_times == [0.0, 1.0]


def test_an_edit_file_that_lacks_its_cage_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    cage = {"type": "cage", "before": "a.ply", "after": "b.ply"}
    path.write_text(json.dumps({"version": 2, "edits": [cage]}))
    with pytest.raises(EditError, match=r"a\.ply"):
        Editor(demo(), path)

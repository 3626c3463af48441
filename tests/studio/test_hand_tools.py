"""What hands do beside dragging handles: pins, locks, formulas, cages, strokes, kept selections."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from objects import demo

from pcore.editing.stack import raw_edit
from pcore.errors import EditError, InputError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.studio.edit_forms import NEW
from pcore.studio.editor import Editor
from pcore.studio.guides import GuideMaker
from pcore.studio.handle_pose import (
    HandlePose,
    axis_of,
    degrees_of,
    is_turned,
    turn_about,
    turn_of_degrees,
    turn_to,
)
from pcore.studio.select_actions import NamedSelections
from pcore.studio.stroke import Stroke


@pytest.fixture
def editor() -> Editor:
    return Editor(demo())


def top(editor: Editor) -> int:
    return int(editor.asset.points[:, 2].argmax())


def raw(editor: Editor) -> dict[str, Any]:
    return raw_edit(editor.session.stack.edits[editor.shown.selected or 0])


def moved(pose: HandlePose, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> HandlePose:
    a, b, c = pose.place
    return replace(pose, place=(a + x, b + y, c + z))


@pytest.mark.parametrize("degrees", [(0, 0, 0), (30, -40, 110), (0, 90, 20), (-170, 10, 5)])
def test_angles_of_a_turn_make_the_same_turn(degrees: tuple[float, float, float]) -> None:
    turn = turn_of_degrees(degrees)
    again = turn_of_degrees(degrees_of(turn))
    place = (0.0, 0.0, 0.0)
    assert not is_turned(HandlePose(place=place, turn=turn), HandlePose(place=place, turn=again))


@pytest.mark.parametrize("axis", ["x", "y", "z", [0.6, 0.0, -0.8], [0.0, 0.0, -1.0]])
def test_an_axis_comes_back_from_its_turn(axis: Any) -> None:
    found = axis_of(turn_to(axis))
    assert found == axis if isinstance(axis, str) else found == pytest.approx(axis, abs=1e-9)


def test_a_pin_holds_where_a_place_was_and_leaves_the_handle_selected(editor: Editor) -> None:
    editor.place_handle(top(editor))
    editor.drag(moved(editor.handles[0], z=0.3))
    editor.drop()
    away = (editor.state.points - editor.asset.points).norm(dim=1)
    taken = int(((away - 0.1).abs()).argmin())
    editor.place_handle(taken, pin=True)
    assert editor.shown.handle == 0
    assert [one.rests for one in editor.handles] == [False, True]
    back = editor.state.points[taken] - editor.asset.points[taken]
    assert float(back.norm()) < 0.2 * float(away[taken])
    editor.undo()
    now = editor.state.points[taken].tolist()
    editor.place_handle(taken)
    assert editor.handles[1].place == pytest.approx(now, abs=1e-5)
    assert editor.shown.handle == 1


def test_a_locked_axis_is_the_only_one_that_a_handle_moves_along(editor: Editor) -> None:
    editor.place_handle(top(editor))
    before = editor.handles[0]
    editor.shown = replace(editor.shown, lock="y")
    editor.drag(moved(before, 0.1, 0.2, 0.3))
    editor.drop()
    assert editor.handles[0].place == pytest.approx(moved(before, y=0.2).place, abs=1e-6)


def test_numbers_put_a_handle_in_one_step_and_rounding_does_not(editor: Editor) -> None:
    editor.place_handle(top(editor))
    depth, (x, y, z) = editor.session.history.now, editor.handles[0].place
    assert editor.put(place=(round(x, 3), round(y, 3), z + 0.1))
    assert editor.session.history.now == depth + 1
    assert editor.handles[0].place == pytest.approx((x, y, z + 0.1), abs=1e-9)
    assert editor.put(degrees=(0.0, 0.0, 25.0))
    assert degrees_of(editor.handles[0].turn) == pytest.approx((0, 0, 25), abs=1e-6)
    editor.select_handle(None)
    with pytest.raises(EditError, match="expected a selected handle"):
        editor.put(place=(0.0, 0.0, 0.0))


@pytest.mark.parametrize("kind", NEW)
def test_every_formula_has_one_handle_that_is_dragged_and_undone(editor: Editor, kind: str) -> None:
    editor.add(kind)
    assert editor.shown.handle == 0
    before, start = editor.handles[0], raw(editor)
    editor.drag(moved(before, x=0.02, z=0.01))
    assert editor.drop()
    assert editor.handles[0].place == pytest.approx(moved(before, x=0.02, z=0.01).place, abs=1e-6)
    turned = replace(editor.handles[0], turn=turn_about("x", math.radians(5)))
    editor.drag(turned)
    editor.drop()
    if kind != "scale":
        assert not is_turned(editor.handles[0], turned)
    with pytest.raises(EditError, match="belongs to the edit"):
        editor.remove_handle()
    editor.undo()
    if kind != "scale":
        editor.undo()
    assert raw(editor)["type"] == start["type"]
    assert editor.handles[0].place == pytest.approx(before.place, abs=1e-9)


def test_the_handle_of_what_moves_moves_it_and_its_sliders_follow(editor: Editor) -> None:
    editor.add("rigid")
    editor.drag(replace(moved(editor.handles[0], x=0.2), turn=turn_about("z", math.radians(40))))
    editor.drop()
    shift = editor.state.points.mean(dim=0) - editor.asset.points.mean(dim=0)
    assert float(shift[0]) == pytest.approx(0.2, abs=0.1)
    assert raw(editor)["angle_deg"] == pytest.approx(40)
    editor.set(0, "angle_deg", 10.0)
    assert degrees_of(editor.handles[0].turn) == pytest.approx((0, 0, 10), abs=1e-6)


def test_an_axis_is_turned_by_its_handle(editor: Editor) -> None:
    editor.add("twist")
    editor.set(0, "angle_deg", 30.0)
    editor.drag(replace(editor.handles[0], turn=turn_about("y", math.radians(90))))
    editor.drop()
    assert raw(editor)["axis"] == "x"


def test_a_cage_changes_nothing_until_a_vertex_is_dragged(editor: Editor, tmp_path: Path) -> None:
    editor.add_cage(tmp_path / "cage.ply", cells=2)
    rest = editor.asset.points
    assert torch.allclose(editor.state.points, rest, atol=1e-6)
    assert all(one.rests for one in editor.handles)
    heights = [one.place[2] for one in editor.handles]
    editor.select_handle(heights.index(max(heights)))
    depth, number = editor.session.history.now, editor.shown.handle
    assert number is not None
    goal = moved(editor.handles[number], z=0.2)
    editor.drag(goal)
    assert editor.drop()
    assert editor.session.history.now == depth + 1
    assert editor.handles[number].place == pytest.approx(goal.place, abs=1e-6)
    assert float((editor.state.points - rest)[:, 2].max()) > 0.02
    path = tmp_path / "edit.json"
    editor.session.save(path)
    assert '"before": "cage.ply"' in path.read_text()
    assert torch.equal(demo().pose(path).points, editor.state.points)
    editor.remove_handle()
    assert torch.allclose(editor.state.points, rest, atol=1e-6)
    editor.undo()
    editor.set(0, "amount", 0.5)
    assert editor.handles[number].place[2] == pytest.approx(goal.place[2] - 0.1, abs=1e-6)


def test_vertices_of_a_cage_move_in_pairs_and_have_keys(editor: Editor, tmp_path: Path) -> None:
    editor.add_cage(tmp_path / "cage.ply", cells=2)
    editor.shown = replace(editor.shown, mirror="y", handle=0)
    before = [one.place for one in editor.handles]
    editor.drag(moved(editor.handles[0], y=0.1, z=0.1))
    editor.drop()
    ways = [
        torch.tensor(b.place) - torch.tensor(a) for a, b in zip(before, editor.handles, strict=True)
    ]
    assert [float(way.norm()) > 0 for way in ways].count(True) == 2
    assert float(torch.stack(ways).sum(dim=0)[1]) == pytest.approx(0, abs=1e-6)
    editor.key(0)
    editor.at(1.0)
    there = moved(editor.handles[0], z=0.1)
    editor.drag(there)
    editor.drop()
    assert editor.key_times == [0.0, 1.0]
    assert editor.handles[0].place == pytest.approx(there.place, abs=1e-6)
    editor.at(0.0)
    assert editor.handles[0].place == pytest.approx(moved(there, z=-0.1).place, abs=1e-6)


def test_a_cage_stands_around_the_selection_and_acts_there(editor: Editor, tmp_path: Path) -> None:
    high = editor.asset.points[:, 2] > editor.asset.points[:, 2].median()
    editor.choose(high)
    editor.add_cage(tmp_path / "cage.ply", cells=1)
    low = min(one.place[2] for one in editor.handles)
    assert low > float(editor.asset.points[:, 2].min())
    assert raw(editor)["region"]["ids"] == high.nonzero().flatten().tolist()


def test_an_edit_acts_where_it_is_told(editor: Editor) -> None:
    editor.add("twist")
    low = editor.asset.points[:, 2] < editor.asset.points[:, 2].median()
    editor.limit(0, low)
    assert raw(editor)["region"]["ids"] == low.nonzero().flatten().tolist()
    editor.set(0, "region/falloff", 0.01)
    editor.limit(0, ~low)
    assert raw(editor)["region"]["falloff"] == 0.01
    with pytest.raises(EditError, match="with Shift held"):
        editor.limit(0, low & ~low)
    editor.limit(0)
    assert "region" not in raw(editor)


def test_selections_are_kept_by_name(tmp_path: Path) -> None:
    mask = torch.arange(10) < 4
    named = NamedSelections(folder=tmp_path / "selections", count=10)
    assert named.names == []
    named.keep("left eye", mask)
    assert named.names == ["left eye"]
    assert torch.equal(named.read("left eye"), mask)
    with pytest.raises(InputError, match="expected letters"):
        named.keep("../x", mask)
    with pytest.raises(InputError, match="none with the name"):
        named.read("right eye")
    with pytest.raises(EditError, match="holds a point"):
        named.keep("none", mask & ~mask)
    with pytest.raises(EditError, match="another object"):
        NamedSelections(folder=tmp_path / "selections", count=11).read("left eye")
    named.forget("left eye")
    assert named.names == []


def camera(editor: Editor) -> Camera:
    return orbit_around(editor.asset.points, size=(200, 160))[0]


def stroke(editor: Editor, tool: str, *shares: tuple[float, float], how: str = "replace") -> Stroke:
    editor.shown = replace(editor.shown, tool=tool)
    made = Stroke(editor, camera(editor), how=how, through=False)
    for share in shares:
        made.add(share)
        made.apply()
    return made


def test_a_brush_paints_on_and_takes_away(editor: Editor) -> None:
    shares = [(0.4, 0.5), (0.5, 0.5), (0.6, 0.55)]
    stroke(editor, "brush", shares[0])
    first = editor.shown.chosen
    stroke(editor, "brush", *shares[1:])
    assert first < editor.shown.chosen
    whole = editor.selector.brush(
        editor.asset.points,
        camera(editor),
        torch.tensor([[80.0, 80.0]]),
        100.0,
    )
    assert len(editor.shown.chosen) < int(whole.sum())
    stroke(editor, "brush", shares[0], how="subtract")
    assert not first & editor.shown.chosen


def test_a_lasso_and_its_outline_are_closed_and_taken_back(editor: Editor) -> None:
    made = stroke(editor, "lasso", (0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7))
    chosen = editor.shown.chosen
    assert 50 < len(chosen) < len(editor.asset.points)
    assert torch.equal(made.outline[0], made.outline[-1])
    made.take_back()
    assert not editor.shown.chosen


def test_a_ball_grows_with_the_drag_along_the_surface(editor: Editor) -> None:
    stroke(editor, "ball", (0.5, 0.5))
    clicked = editor.shown.chosen
    assert clicked
    stroke(editor, "ball", (0.5, 0.5), (0.6, 0.5))
    small = editor.shown.chosen
    stroke(editor, "ball", (0.5, 0.5), (0.8, 0.5))
    assert small < editor.shown.chosen
    before = editor.shown.chosen
    stroke(editor, "ball", (0.01, 0.01))
    assert editor.shown.chosen == before, "beside the object nothing is meant"


def test_guides_show_reach_axes_cages_and_locks(editor: Editor, tmp_path: Path) -> None:
    maker = GuideMaker()
    assert not len(maker.of(editor).lines)
    editor.place_handle(top(editor))
    near = maker.of(editor)
    editor.set(0, "reach", 0.3)
    nearer = maker.of(editor).rim
    place = torch.tensor(editor.handles[0].place)
    assert float((nearer - place).norm(dim=1).max()) <= 0.3 + 1e-6
    assert float((near.rim - place).norm(dim=1).max()) > 0.3
    editor.shown = replace(editor.shown, lock="x")
    assert maker.of(editor).lines.shape == (1, 2, 3)
    editor.shown = replace(editor.shown, lock="off")
    editor.add("bend")
    assert len(maker.of(editor).lines) > 90
    editor.add_cage(tmp_path / "cage.ply", cells=1)
    assert maker.of(editor).lines.shape == (12, 2, 3), "edges of a box, without diagonals"

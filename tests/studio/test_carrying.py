"""Handles of earlier edits lie on the object that later edits make; folds have a way out."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from objects import demo

from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of
from pcore.studio.editor import Editor
from pcore.studio.guides import GuideMaker


def test_a_later_edit_carries_the_handle_of_a_twist() -> None:
    editor = Editor(demo())
    size = size_of(editor.asset.points)
    editor.add("twist")
    editor.set(0, "angle_deg", 20.0)
    own = editor.handles[0].place
    editor.add("rigid")
    editor.set(1, "translation/0", 0.2 * size)
    editor.set(1, "angle_deg", 90.0)
    editor.select(0)
    seen = editor.handles[0]
    center = editor.raw(1)["origin"]
    x, y, z = (a - b for a, b in zip(own, center, strict=True))
    expected = (center[0] - y + 0.2 * size, center[1] + x, center[2] + z)
    assert seen.place == pytest.approx(expected, abs=1e-6 * size)

    wanted = replace(seen, place=(seen.place[0], seen.place[1] + 0.1 * size, seen.place[2]))
    editor.drag(wanted)
    assert editor.drop()
    # Turned by 90 degrees about z: what is y on the page is x where the twist acts.
    moved = [a - b for a, b in zip(editor.raw(0)["origin"], own, strict=True)]
    assert moved == pytest.approx([0.1 * size, 0.0, 0.0], abs=1e-6 * size)
    assert editor.raw(0)["axis"] == "z"
    assert editor.handles[0].place == pytest.approx(wanted.place, abs=1e-6 * size)


def test_a_later_edit_carries_the_vertices_of_a_cage(tmp_path: Path) -> None:
    editor = Editor(demo())
    size = size_of(editor.asset.points)
    editor.add_cage(tmp_path / "cage.ply", cells=1)
    own = [one.place for one in editor.handles]
    lines = GuideMaker().of(editor).lines
    editor.add("rigid")
    editor.set(1, "angle_deg", 90.0)
    center = editor.raw(1)["origin"]
    editor.select(0)
    for one, seen in zip(own, editor.handles, strict=True):
        x, y, z = (a - b for a, b in zip(one, center, strict=True))
        turned = (center[0] - y, center[1] + x, center[2] + z)
        assert seen.place == pytest.approx(turned, abs=1e-6 * size)
    assert not torch.allclose(GuideMaker().of(editor).lines, lines)

    editor.select_handle(0)
    x, y, z = editor.handles[0].place
    wanted = (x + 0.1 * size, y, z)
    editor.drag(replace(editor.handles[0], place=wanted))
    assert editor.drop()
    assert editor.handles[0].place == pytest.approx(wanted, abs=1e-3 * size)
    moved = [a - b for a, b in zip(editor.raw(0)["after"][0], own[0], strict=True)]
    # Turned by 90 degrees about z: what is x on the page is -y where the cage acts.
    assert moved == pytest.approx([0.0, -0.1 * size, 0.0], abs=1e-3 * size)


def test_a_handle_lands_where_it_is_dragged_under_a_bend() -> None:
    editor = Editor(demo())
    size = size_of(editor.asset.points)
    editor.add("scale")
    editor.add("bend")
    editor.set(1, "angle_deg", 60.0)
    editor.select(0)
    x, y, z = editor.handles[0].place
    wanted = (x + 0.1 * size, y - 0.05 * size, z + 0.15 * size)
    editor.drag(replace(editor.handles[0], place=wanted))
    assert editor.drop()
    assert editor.handles[0].place == pytest.approx(wanted, abs=1e-3 * size)


def test_a_drag_that_folds_can_be_had_with_a_wider_seam() -> None:
    editor = Editor(demo())
    points = editor.asset.points
    size = size_of(points)
    upper = (points[:, 2] > points[:, 2].median()).nonzero().flatten().tolist()
    editor.shown = replace(editor.shown, chosen=frozenset(upper))
    editor.session.freeze({**editor.region(), "falloff": 0.01 * size})
    editor.add("twist")
    assert not editor.widens
    for angle in (60.0, 150.0):
        editor.slide(0, "angle_deg", angle)
    assert not editor.settle()
    assert editor.raw(0)["angle_deg"] == 60.0
    before = editor.session.history.now

    assert editor.widens
    falloff = editor.widen()
    assert falloff > 0.01 * size
    assert editor.raw(0)["angle_deg"] == 150.0
    assert editor.session.stack.freeze[0].falloff == falloff
    assert not len(editor.session.state.folds)
    assert editor.session.history.now == before + 1
    assert not editor.widens
    with pytest.raises(EditError, match="expected a drag that folds"):
        editor.widen()
    editor.undo()
    assert editor.raw(0)["angle_deg"] == 60.0

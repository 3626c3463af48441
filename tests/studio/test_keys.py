"""Keys of the page: what they do, and that help and guide tell of each."""

import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from objects import demo

from pcore.studio.guard import Guard
from pcore.studio.help_text import HELP, NO_SCALE
from pcore.studio.hotkeys import HOTKEYS
from pcore.studio.outputs import Outputs

pytest.importorskip("viser", reason="the extra studio is not installed")
from pcore.studio.handle_nodes import _GIZMO, Grab
from pcore.studio.studio import Studio

TAB = 1
GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "studio.md"
NAMES = {
    **{"pageup": "PageUp", "pagedown": "PageDown", "escape": "Escape", "delete": "Delete"},
    **{"enter": "Enter", "arrowleft": "Left", "arrowright": "Right"},
}
HELD = {None: "", "shift": "Shift-", "cmd/ctrl": "Ctrl-", "cmd/ctrl+shift": "Ctrl-Shift-"}


@pytest.fixture
def page(tmp_path: Path, free_port: int) -> Iterator[Studio]:
    outputs = Outputs(folder=tmp_path / "studio", edit=tmp_path / "edit.json", run=tmp_path)
    with closing(Studio(demo(), Guard(port=free_port), outputs, title="demo")) as studio:
        studio._owner = TAB
        yield studio


def press(page: Studio, key: str, held: str | None = None) -> None:
    wish, *values = next(row[3:] for row in HOTKEYS if row[1:3] == (key, held))
    page.wishes[wish](TAB, *values)
    assert page.worker.wait(60)


def written() -> set[str]:
    """Keys as people read them; the same wish with Shift, as of strokes, is told once."""
    plain = {row[3:] for row in HOTKEYS if row[2] is None}
    told = [row for row in HOTKEYS if row[2] is None or row[3:] not in plain]
    return {HELD[held] + NAMES.get(key, key) for _, key, held, *_ in told}


def keys_of_the_guide() -> str:
    return GUIDE.read_text().split("## Keys")[1].split("##")[0]


@pytest.mark.parametrize("text", [HELP, keys_of_the_guide()], ids=["help", "guide"])
def test_every_key_is_told(text: str) -> None:
    missing = [
        key for key in written() if not re.search(rf"(?<![\w-]){re.escape(key)}(?![\w-])", text)
    ]
    assert missing == []


def test_the_guide_tells_of_no_other_keys() -> None:
    rows = re.findall(r"^\| (?!\|)(.*?) \|", keys_of_the_guide(), re.MULTILINE)
    told = {key.strip() for row in rows if not row.startswith("-") for key in re.split("[,;]", row)}
    assert told - {"Shift-wheel"} == written()


def test_keys_choose_what_arrows_and_rings_do(page: Studio) -> None:
    page.editor.add("part")
    press(page, "1")
    assert page.nodes._gizmo.disable_rotations
    assert not page.nodes._gizmo.disable_axes
    press(page, "2")
    assert page.nodes._gizmo.disable_axes
    assert not page.nodes._gizmo.disable_rotations
    press(page, "2")
    assert page.editor.shown.gizmo == "all"
    page.editor.add("twist")
    press(page, "3")
    assert page._said == NO_SCALE
    assert page.nodes._gizmo is None, "a twist has nothing to scale"


@pytest.mark.parametrize(("kind", "rest"), [("part", 1.0), ("scale", 1.0), ("stretch", 0.0)])
def test_an_arrow_pulled_by_a_tenth_makes_it_a_tenth_larger(
    page: Studio, kind: str, rest: float
) -> None:
    page.editor.add(kind)
    press(page, "3")
    depth, gizmo = page.editor.session.history.now, page.nodes._gizmo
    start = np.asarray(gizmo.position)

    def pull(phase: str, by: float) -> None:
        target = SimpleNamespace(position=start + np.array([0.0, 0.0, by * _GIZMO]))
        page.nodes._tell_scale(SimpleNamespace(client_id=TAB, phase=phase, target=target))
        assert page.worker.wait(60)

    pull("start", 0.0)
    pull("update", 0.1)
    assert page.editor.present is not None
    assert page.editor.present["factor"] == pytest.approx(rest + 0.1)
    assert page.editor.raw(0).get("factor", rest) == rest
    pull("end", 0.1)
    assert page.editor.raw(0)["factor"] == pytest.approx(rest + 0.1)
    assert page.editor.session.history.now == depth + 1
    pull("start", 0.0)
    pull("update", -0.1)
    press(page, "escape")
    pull("update", -0.2)
    assert page.editor.raw(0)["factor"] == pytest.approx(rest + 0.1)
    assert not page.editor.dragging


def test_the_reach_of_handles_is_scaled(page: Studio) -> None:
    page.editor.place_handle(10)
    page.editor.set(0, "reach", 0.2)
    page.actions.scale(1.5)
    page.actions.settle()
    assert page.editor.raw(0)["reach"] == pytest.approx(0.3)


def test_a_ball_goes_where_the_pointer_is_in_the_plane_of_the_picture() -> None:
    eye, ball = np.array([10.0, -8.0, 5.0]), np.array([1.0, 2.0, 3.0])
    way = (ball - eye) / np.linalg.norm(ball - eye)
    taken = eye + 0.7 * (ball - eye)
    across = np.cross(way, [0.0, 0.0, 1.0])
    pointer = taken + 0.4 * across + 0.2 * np.cross(way, across)
    found = Grab.of(ball, taken, eye).at(pointer)
    assert (found - ball) @ way == pytest.approx(0.0, abs=1e-12)
    assert np.cross(found - eye, pointer - eye) == pytest.approx(np.zeros(3), abs=1e-9)
    beside = Grab.of(ball, ball + 0.3 * across, eye)
    assert beside.at(ball + 0.3 * across) == pytest.approx(ball), "it does not jump to the pointer"


def test_arrows_step_through_time_and_with_shift_from_key_to_key(page: Studio) -> None:
    page.editor.add("twist")
    page.editor.key(0)
    page.editor.at(0.5)
    page.editor.key(0)
    press(page, "arrowleft")
    assert page.editor.session.time == pytest.approx(0.48)
    press(page, "arrowright")
    assert page.editor.session.time == 0.5
    press(page, "arrowright", "shift")
    assert page.editor.session.time == 0.5
    press(page, "arrowleft", "shift")
    assert page.editor.session.time == 0.0
    press(page, "arrowleft")
    assert page.editor.session.time == 0.0


def test_points_and_the_comparison_are_put_on_and_off(page: Studio) -> None:
    for key, name in (("P", "moving"), ("C", "compare")):
        before = getattr(page.editor.shown, name)
        press(page, key)
        assert getattr(page.editor.shown, name) != before
        press(page, key)
        assert getattr(page.editor.shown, name) == before


def test_after_enter_the_next_handle_begins_another_edit(page: Studio) -> None:
    page.editor.place_handle(10)
    press(page, "enter")
    assert page.editor.shown.selected is None
    page.editor.place_handle(500)
    assert len(page.editor.session.stack.edits) == 2


class FakeGui:
    """Counts the buttons of a tab."""

    def __init__(self) -> None:
        self.buttons: list[str] = []

    def add_button(self, label: str, **_: Any) -> Any:
        self.buttons.append(label)
        remove = self.buttons.clear
        return SimpleNamespace(on_click=lambda _: None, remove=remove)


def test_only_tabs_that_look_are_offered_to_edit(page: Studio) -> None:
    guis = {number: FakeGui() for number in (1, 2)}
    clients = {number: SimpleNamespace(gui=gui) for number, gui in guis.items()}
    page.panels.roles(clients, 1)
    page.panels.roles(clients, 1)
    assert (guis[1].buttons, guis[2].buttons) == ([], ["Edit in this tab"])
    page.panels.roles(clients, 2)
    assert (guis[1].buttons, guis[2].buttons) == (["Edit in this tab"], [])


def test_while_a_brush_paints_the_panel_counts(page: Studio) -> None:
    count = page.panels._selection._count
    page.editor.choose(demo().points[:, 2] > 0)
    page._show_drag()
    assert f"{len(page.editor.shown.chosen):,} points are selected" in count.content
    page.editor.choose(demo().points[:, 2] > 100)
    page._show_drag()
    assert "Nothing is selected" in count.content


def test_a_ball_does_not_run_away_from_a_pointer_that_waits(page: Studio) -> None:
    """The node that is taken moves along; where it was taken stays what it was."""
    page.editor.place_handle(10)
    page.perform(lambda: None)
    assert page.worker.wait(60)
    ball = page.nodes._balls[0]
    eye, taken = np.array([30.0, 0.0, 0.0]), np.array(ball.position)
    grab = Grab.of(ball.position, taken, eye)
    pointer = taken + np.array([0.0, 1.0, 0.5])
    goal = grab.at(pointer)
    for _ in range(3):
        ball.position = grab.at(pointer)
    assert np.asarray(ball.position) == pytest.approx(goal, abs=1e-9)

"""A whole page whose tab is not a browser: what its widgets wish, its files, its messages."""

import json
import resource
import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch
from objects import demo

from lying_world import in_lying_world
from pcore.cli.main import main
from pcore.data.pictures import write_png
from pcore.errors import EditError
from pcore.geometry.orbit import orbit_around
from pcore.studio.editor import Editor
from pcore.studio.gestures import Pause
from pcore.studio.guard import Guard
from pcore.studio.handle_pose import HandlePose
from pcore.studio.outputs import Outputs
from pcore.studio.page_frame import SIZE
from pcore.studio.status_line import StatusLine

pytest.importorskip("viser", reason="the extra studio is not installed")
from pcore.studio.studio import _SWEEP, Studio

TAB = 1


@pytest.fixture
def page(tmp_path: Path, free_port: int) -> Iterator[Studio]:
    with closing(opened(tmp_path, free_port)) as studio:
        yield studio


def opened(folder: Path, port: int, edit: str = "edit.json") -> Studio:
    outputs = Outputs(folder=folder / "studio", edit=folder / "studio" / edit, run=folder)
    studio = Studio(demo(), Guard(port=port), outputs, title="demo")
    studio._owner = TAB
    return studio


def wish(page: Studio, name: str, *values: Any) -> None:
    page.wishes[name](TAB, *values)
    assert page.worker.wait(60)


def until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 60  # Of a machine that does other things as well.
    while not holds():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


def test_a_slider_is_drawn_at_once_and_kept_as_one_step_when_it_rests(page: Studio) -> None:
    wish(page, "add", "twist")
    history, waits = page.editor.session, page._pause
    touched = list[int]()
    page._pause = cast("Any", SimpleNamespace(touch=lambda: touched.append(1)))
    depth = history.history.now
    for angle in (10.0, 20.0, 30.0):
        wish(page, "slide", 0, "angle_deg", angle)
    assert page.editor.present == {**page.editor.raw(0), "angle_deg": 30.0}
    assert history.history.now == depth
    assert len(touched) == 3
    waits._do()
    assert page.worker.wait(60)
    assert page.editor.raw(0)["angle_deg"] == 30.0
    wish(page, "slide", 0, "angle_deg", 40.0)
    wish(page, "undo")
    assert page.editor.raw(0)["angle_deg"] == 30.0, "two drags are two steps"
    assert history.history.now == depth + 1


def test_a_page_that_no_tab_has_joined_is_loading(page: Studio) -> None:
    assert "Loading" in page._status()


def test_an_overlay_says_what_its_colours_mean_or_why_there_are_none(page: Studio) -> None:
    wish(page, "overlay", "strain")
    assert "stretched" in page._said
    wish(page, "overlay", "exposed")
    assert "photos" in page._said


def test_what_waits_for_a_pause_is_done_once_after_it() -> None:
    done = list[float]()
    pause = Pause(0.5, lambda: done.append(time.monotonic()))
    for _ in range(3):
        pause.touch()
        last = time.monotonic()
    until(lambda: bool(done))
    assert done[0] >= last + 0.45
    assert len(done) == 1


def test_autosaves_are_seconds_apart_and_the_last_one_is_written_at_the_end(page: Studio) -> None:
    page.files._written = time.monotonic() + 100
    wish(page, "add", "twist")
    wish(page, "add", "bend")
    assert not page.outputs.autosave.exists()
    page.close()
    assert json.loads(page.outputs.autosave.read_text())["now"] == 2


def test_letters_of_a_name_are_one_step_and_leave_its_field(page: Studio) -> None:
    wish(page, "add", "twist")
    panel, depth = page.panels._edits, page.editor.session.history.now
    field = panel._name
    for name in ("l", "le", "left arm"):
        wish(page, "rename", 0, name)
    assert panel._name is field
    assert panel._list[0].label == "1 · left arm"
    assert page.editor.session.history.now == depth + 1
    wish(page, "undo")
    assert panel._name is field
    assert field.value == "Twist"


def test_a_drag_that_was_put_back_stays_so_until_it_begins_anew(page: Studio) -> None:
    page.actions._editor.place_handle(10)
    page.editor.select_handle(0)
    start = page.editor.handles[0].place

    def tell(phase: str) -> None:
        x, y, z = page.frame.to_page(start)
        event = SimpleNamespace(client_id=TAB, phase=phase)
        page.nodes._tell(event, (x, y, z + 0.3), None)
        assert page.worker.wait(60)

    tell("start")
    assert page.editor.dragging
    wish(page, "cancel")
    tell("update")
    assert not page.editor.dragging
    tell("end")
    assert page.editor.handles[0] == HandlePose(place=start, rests=True)
    tell("start")
    assert page.editor.dragging


def test_save_goes_where_it_was_saved_last_and_the_command_names_that(
    tmp_path: Path, free_port: int
) -> None:
    with closing(opened(tmp_path, free_port, "Körper (1).json")) as page:
        wish(page, "add", "twist")
        wish(page, "top", "Save")
        assert page.outputs.edit.is_file(), "its own name needs not be one that pages may give"
        wish(page, "save", "other.json")
        wish(page, "add", "bend")
        wish(page, "top", "Save")
        assert len(json.loads((tmp_path / "studio" / "other.json").read_text())["edits"]) == 2
        line = page.outputs.line(
            "OUT", Path("c.json"), edit=page.files.edit, time=1 / 3, light=None
        )
        assert "other.json" in line
        assert f"--time {1 / 3!r}" in line


def test_nothing_is_saved_over_what_is_no_edit_file(page: Studio, tmp_path: Path) -> None:
    wish(page, "add", "twist")
    other = tmp_path / "studio" / "mine.json"
    other.write_text('{"frames": []}')
    for name in ("autosave.json", "mine.json"):
        wish(page, "save", name)
        assert page._said.startswith("⚠"), name
        assert not page.files.saved
    assert other.read_text() == '{"frames": []}'
    assert page.outputs.autosave.is_file()
    for name in ("a.json", "b.json", "a.json"):
        wish(page, "save", name)
        assert page._said == f"Saved as {name}."


def test_a_command_without_edits_reads_no_file_that_is_not_there(
    page: Studio, run: Path, tmp_path: Path
) -> None:
    camera = orbit_around(demo().points, size=(16, 16))[0]
    tab = cast("Any", SimpleNamespace(camera=lambda **_: camera, number=TAB))
    page.perform(lambda: page.files.screenshot(tab, 16))
    assert page.worker.wait(60)
    line = page.files.line.split("```")[1].strip()
    assert "Save first" not in page.files.line
    program, command, _, *words = shlex.split(line)
    assert program == "pcore"
    output = tmp_path / "again"
    assert main([command, str(run), *words[:-1], str(output)]) == 0
    (again,) = output.glob("*.png")
    assert again.read_bytes() == (page.outputs.folder / "picture_001.png").read_bytes()
    wish(page, "add", "twist")
    wish(page, "save", "edit.json")
    page.outputs.edit.unlink()
    page.perform(lambda: page.files.screenshot(tab, 16))
    assert page.worker.wait(60)
    assert "Save first" in page.files.line


@pytest.mark.parametrize("how", ["edited", "saved"])
def test_what_nobody_restored_is_moved_aside_and_opened_later(
    page: Studio, tmp_path: Path, how: str
) -> None:
    before = Editor(demo())
    before.add("taper")
    page.outputs.keep(before.session, [])
    if how == "edited":
        wish(page, "add", "twist")
    wish(page, "top", "Save")
    wish(page, "open", "autosave_001.json")
    assert page.editor.raw(0)["type"] == "taper"
    assert not page.files.saved


def test_a_cage_whose_file_is_gone_is_said_and_the_panel_goes_on(page: Studio) -> None:
    wish(page, "add", "cage")
    page.editor.select_handle(0)
    (page.outputs.folder / "cage_001.ply").unlink()
    wish(page, "lock", "x")
    assert page.panels._edits._lock.value == "x"
    assert "cage_001.ply" in page._said
    assert str(page.outputs.folder) not in page._said
    wish(page, "order", 0, "Delete")
    assert not page.editor.session.stack.edits


def test_a_cage_whose_file_is_gone_is_written_again_at_save(
    page: Studio, tmp_path: Path, free_port: int
) -> None:
    wish(page, "add", "cage")
    cage = page.outputs.folder / "cage_001.ply"
    before = cage.read_bytes()
    cage.unlink()
    wish(page, "save", "edit.json")
    assert page._said == "Saved as edit.json."
    assert cage.read_bytes() == before
    page.close()
    with closing(opened(tmp_path, free_port)) as again:
        assert again.worker.wait(60)
        cage.unlink()
        wish(again, "save", "other.json")
        assert Editor(demo(), again.outputs.folder / "other.json").handles
        assert cage.read_bytes() == before


def test_files_of_regions_and_of_keys_that_are_gone_are_written_again(page: Studio) -> None:
    folder, points = page.outputs.folder, page.editor.asset.points
    folder.mkdir(parents=True, exist_ok=True)
    names = ["mask.npy", "before.npy", "first.npy", "last.npy"]
    places = [points.double().numpy() + 0.01 * step for step in range(3)]
    for name, content in zip(names, [np.arange(len(points)) < 9, *places], strict=True):
        np.save(folder / name, content)
    mask, before, first, last = (str(folder / name) for name in names)
    keys = {"keyframes": [[0, first], [1, last]]}
    page.editor.session.do({"type": "displacement", "before": before, "after": keys})
    part = {"shape": "mask", "file": mask, "falloff": 0.1}
    page.editor.session.do({"type": "twist", "axis": "z", "angle_deg": 3, "region": part})
    page._refresh()
    contents = [(folder / name).read_bytes() for name in names]
    for name in names:
        (folder / name).unlink()
    wish(page, "save", "edit.json")
    assert page._said == "Saved as edit.json."
    assert [(folder / name).read_bytes() for name in names] == contents


def test_a_save_says_which_files_of_others_are_gone(page: Studio, tmp_path: Path) -> None:
    page.editor.add_cage(tmp_path / "theirs.ply", cells=1)
    page.editor.add("twist")
    page._refresh()
    (tmp_path / "theirs.ply").unlink()
    wish(page, "save", "edit.json")
    assert page._said == "Saved as edit.json. ⚠ It names files that are gone: theirs.ply."
    assert not (tmp_path / "theirs.ply").exists()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        *((name, ("q",)) for name in ("gizmo", "overlay", "click", "mirror", "lock", "moving")),
        *(("tool", ("q",)), ("compare", (1.5,)), ("compare", (float("nan"),))),
        *(("selection", ("Nonsense",)), ("selection", ("Undo",))),
        *(("add", ("nope",)), ("add", (None,)), ("order", (0, "Nonsense"))),
        *(("slide", (0, "nope/3", 1.0)), ("slide", (0, "limits/2", 1.0))),
        *(("slide", (0, "origin/3", 1.0)), ("slide", (0, "angle_deg/0", 1.0))),
    ],
)
def test_what_is_none_of_the_choices_is_refused_and_changes_nothing(
    page: Studio, name: str, values: tuple[Any, ...]
) -> None:
    wish(page, "add", "twist")
    shown, stack = page.editor.shown, page.editor.session.stack
    wish(page, name, *values)
    assert page._said.startswith("⚠")
    assert "see the terminal" not in page._said
    assert page.editor.shown == shown
    assert page.editor.session.stack is stack
    assert not page.editor.sliding


def test_what_was_opened_is_saved_until_it_changes_and_nothing_before_it_is_lost(
    page: Studio,
) -> None:
    wish(page, "add", "twist")
    wish(page, "save", "a.json")
    page.files._written = time.monotonic() + 100
    wish(page, "add", "bend")
    wish(page, "open", "a.json")
    assert page.files.saved
    assert "1 edit, saved" in page._status()
    kept = json.loads(page.outputs.autosave.read_text())
    assert [one["type"] for one in kept["edits"][-1]["edits"]] == ["twist", "bend"]
    wish(page, "undo")
    assert len(page.editor.session.stack.edits) == 2
    assert not page.files.saved
    wish(page, "redo")
    wish(page, "save", "a.json")
    wish(page, "open", "a.json")
    assert page.files.saved
    assert not page.outputs.autosave.exists()


def test_a_full_disk_at_a_picture_is_said_and_leaves_nothing(page: Studio) -> None:
    path, limits = page.outputs.next("picture", ".png"), resource.getrlimit(resource.RLIMIT_FSIZE)

    def write() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        try:
            write_png(path, torch.rand(32, 32, 3))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    page.perform(write)
    assert page.worker.wait(60)
    assert page._said == "⚠ picture_001.png: File too large"
    assert list(path.parent.iterdir()) == []


def test_messages_to_tabs_do_not_pile_up(page: Studio) -> None:
    assert page.worker.wait(60)  # It refreshes, too.
    page.editor.add("twist")
    page.editor.add("bend")
    kept = page.server._websock_server._broadcast_buffer.message_from_id  # pyright: ignore
    counts = list[int]()
    for _ in range(2):
        for number in range(10):
            page.editor.select(number % 2)
            page._refresh()
        page._refreshed += _SWEEP - page._refreshed % _SWEEP - 1
        page._refresh()
        counts.append(len(kept))
    assert counts[1] == counts[0]


def test_a_value_that_folds_is_shown_and_the_last_good_one_kept() -> None:
    editor = Editor(demo())
    editor.add("part")
    editor.slide(0, "translation/0", 0.01)
    editor.slide(0, "translation/0", 0.8)
    assert len(editor.state.folds)
    assert not editor.settle()
    assert editor.back == ""
    assert editor.raw(0)["translation"] == [0.01, 0.0, 0.0]


def test_every_slider_of_an_edit_slides_and_a_changed_one_settles_the_last() -> None:
    editor = Editor(demo())
    editor.add("rigid")
    depth = editor.session.history.now
    editor.slide(0, "translation/0", 0.1)
    editor.slide(0, "translation/2", 0.2)
    assert editor.settle()
    assert editor.raw(0)["translation"] == [0.1, 0.0, 0.2]
    assert editor.session.history.now == depth + 2
    with pytest.raises(EditError):
        editor.slide(5, "angle_deg", 1.0)


def test_the_tour_follows_what_is_done() -> None:
    editor, line = Editor(demo()), StatusLine(tour=True)

    def step(*, saved: bool = False) -> str:
        line.go_on(editor, saved=saved)
        return line.text(editor, saved=saved, said="", drawn=True).splitlines()[-1][:8]

    assert step(saved=True) == "**1 of 4"
    editor.place_handle(10)
    assert step() == "**2 of 4"
    editor.undo()
    editor.redo()
    editor.place_handle(500)
    assert step() == "**2 of 4"
    editor.select_handle(0)
    x, y, z = editor.handles[0].place
    editor.drag(HandlePose(place=(x, y, z + 0.02)))
    assert editor.drop()
    assert step() == "**3 of 4"
    editor.undo()
    editor.add("twist")
    assert step() == "**3 of 4"
    editor.set(1, "angle_deg", 20.0)
    assert step() == "**4 of 4"
    assert step(saved=True) == "That was"


def test_a_capture_stands_as_it_was_photographed_and_fills_the_page(
    tmp_path: Path, free_port: int
) -> None:
    """Its world lies on its side, and a few Gaussians of the room are far away."""
    asset = in_lying_world(tmp_path / "toy")
    outputs = Outputs(folder=tmp_path / "studio", edit=tmp_path / "studio" / "e.json", run=tmp_path)
    with closing(Studio(asset, Guard(port=free_port), outputs, title="toy")) as page:
        camera = page.server.initial_camera
        assert camera.up is not None
        assert camera.up[1] < -0.95
        assert camera.position @ camera.up > 0
        on_page = page.frame.to_page(asset.points[:200].numpy())
        assert float(abs(on_page).max()) == pytest.approx(SIZE / 2, rel=0.5)
        page.editor.place_handle(0)
        reach = page.editor.raw(0)["reach"]
        assert reach == pytest.approx(0.25 * page.editor.size)
        assert reach < 0.1
        page.editor.add("twist")
        twist = page.editor.raw(1)
        assert twist["region"]["shape"] == "box"
        assert max(map(abs, twist["origin"])) < 0.25
        page.editor.set(1, "angle_deg", 40.0)
        assert torch.equal(page.editor.state.points[200:], asset.points[200:])
        assert not torch.equal(page.editor.state.points[:200], asset.points[:200])
        assert twist["region"]["falloff"] == pytest.approx(0.05 * page.editor.size)
        # What was moved away is still what the next edit acts on; a part is a ball in it.
        page.editor.add("rigid")
        page.editor.set(2, "translation", [3.0, 0.0, 0.0])
        page.editor.add("scale")
        assert page.editor.raw(3)["region"]["lower"][0] > 1.5
        page.editor.add("part")
        assert page.editor.raw(4)["region"]["shape"] == "geodesic"

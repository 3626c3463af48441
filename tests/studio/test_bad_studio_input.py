"""What people do to a page and to its objects, without a browser."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from objects import demo

from pcore.asset.asset import Asset
from pcore.asset.saving import asset_of
from pcore.errors import EditError, InputError, PcoreError
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.orbit import orbit_around
from pcore.studio.camera_keys import keys_file
from pcore.studio.drawing import Drawer
from pcore.studio.editor import Editor
from pcore.studio.handle_pose import HandlePose
from pcore.studio.outputs import Outputs
from pcore.studio.page_frame import PageFrame
from pcore.studio.recording import record
from pcore.studio.select_actions import NamedSelections
from pcore.studio.shown import OVERLAYS
from pcore.studio.stroke import Stroke
from pcore.studio.tabs import Tabs
from pcore.studio.viewer_page import viewer_page

EYE = torch.tensor([3.0, 2.0, 1.0])


def made(count: int, *, degree: int = 0, spread: float = 1.0) -> Asset:
    """So many Gaussians, without normals and without a light."""
    gaussians = Gaussians(
        means=torch.rand(count, 3) * spread,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        scales=torch.full((count, 3), 0.01 * spread),
        opacities=torch.full((count,), 0.9),
        sh=torch.rand(count, (degree + 1) ** 2, 3),
    )
    return asset_of(gaussians)


def test_without_a_light_it_is_edited_and_drawn() -> None:
    asset = made(200)
    editor, drawer = Editor(asset), Drawer(asset)
    editor.add("twist")
    editor.set(0, "angle_deg", 30.0)
    posed = drawer.posed(editor.state, still=True)
    assert torch.equal(posed.points, editor.state.points)
    assert len(drawer.splats(editor.state, EYE)) == 200


def test_one_point_is_dragged_and_drawn() -> None:
    asset = made(1)
    editor, drawer = Editor(asset), Drawer(asset)
    frame = PageFrame.around(asset.points)
    editor.add("rigid")
    editor.set(0, "translation/0", 0.5)
    for overlay in OVERLAYS:
        if overlay not in ("strain", "holes"):
            drawer.dots(editor.state, overlay, frozenset({0}))
    drawer.dots(editor.state, "strain", frozenset())
    assert frame.buffer(drawer.splats(editor.state, EYE)).shape == (1, 8)
    assert viewer_page(record(asset, [asset.pose()]), title="one").content
    with pytest.raises(PcoreError):
        editor.place_handle(0)


def test_many_points_make_a_page_that_fits() -> None:
    asset = made(60_000, degree=1)
    page = viewer_page(record(asset, [asset.pose()]), title="many", limit=300_000)
    assert len(page.content) <= 300_000
    assert "splats that show most" in page.notes[-1]


@pytest.mark.slow
def test_300_000_points_are_edited_selected_and_sent() -> None:
    asset = made(300_000)
    editor, drawer = Editor(asset), Drawer(asset)
    editor.add("twist")
    editor.set(0, "angle_deg", 20.0)
    frame = PageFrame.around(asset.points)
    buffer = frame.buffer(drawer.splats(editor.state, EYE))
    assert buffer.nbytes == 300_000 * 32
    editor.shown = replace(editor.shown, tool="brush")
    camera = orbit_around(asset.points, size=(200, 150))[0]
    stroke = Stroke(editor, camera, how="replace", through=False)
    stroke.add((0.5, 0.5))
    stroke.apply()
    assert 0 < len(editor.shown.chosen) < 30_000
    assert len(drawer.dots(editor.state, "none", editor.shown.chosen).points)


@pytest.mark.parametrize("spread", [1e-5, 1e5])
def test_objects_of_any_size_are_as_large_on_the_page(spread: float) -> None:
    asset = made(100, spread=spread)
    frame = PageFrame.around(asset.points)
    buffer = frame.buffer(Drawer(asset).splats(Editor(asset).state, EYE * spread))
    places = buffer[:, :3].view("float32")
    assert 5 < abs(places).max() < 20
    shapes = buffer[:, 4:7].copy().view("float16")
    assert (shapes[:, 0] > 0).all()
    world = frame.to_world(frame.to_page(asset.points.numpy()))
    assert abs(world - asset.points.numpy()).max() < 1e-5 * spread


def test_an_edit_of_another_run_is_refused_with_its_reason(tmp_path: Path) -> None:
    path = tmp_path / "edit.json"
    far = {"type": "anchors", "handles": [{"near": [90, 0, 0], "to": [91, 0, 0]}]}
    path.write_text(json.dumps({"version": 2, "edits": [far]}))
    with pytest.raises(EditError, match="expected a place on the object"):
        Editor(demo(), path)


def outputs(folder: Path) -> Outputs:
    return Outputs(folder=folder / "studio", edit=folder / "studio" / "edit.json", run=folder)


def test_names_of_a_page_stay_in_its_folder(tmp_path: Path) -> None:
    for name in ("../x.json", "/etc/passwd", "a/b.json", "x.txt", "", ".json", "edit.JSON"):
        with pytest.raises(InputError, match="expected letters"):
            outputs(tmp_path).named(name, ".json")
    assert outputs(tmp_path).named("pose 2.json", ".json").parent == tmp_path / "studio"


@pytest.mark.parametrize(
    "name",
    [
        *("autosave.json", "Autosave.json", "autosave_001.json", "autosave_mine.json"),
        *("edit.cameras.json", "edit.CAMERAS.json", "picture_001.json", "FILM_012.json"),
    ],
)
def test_names_of_files_that_the_studio_writes_for_itself_are_refused(
    tmp_path: Path, name: str
) -> None:
    with pytest.raises(InputError, match="keeps for itself"):
        outputs(tmp_path).named(name, ".json")
    with pytest.raises(InputError, match="keeps for itself"):
        Outputs(folder=tmp_path, edit=tmp_path / name, run=tmp_path)


def test_edit_files_of_other_endings_have_camera_keys_of_their_own(tmp_path: Path) -> None:
    files = {keys_file(tmp_path / name).name for name in ("edit.json", "edit.JSON", "edit.txt")}
    assert files == {"edit.cameras.json", "edit.JSON.cameras.json", "edit.txt.cameras.json"}


def test_an_autosave_comes_back_with_its_history_and_not_for_another_object(
    tmp_path: Path,
) -> None:
    from pcore.editing.autosave import read_session

    out, editor = outputs(tmp_path), Editor(demo())
    assert not out.left_over
    editor.add("twist")
    editor.set(0, "angle_deg", 30.0)
    out.keep(editor.session, [])
    assert out.left_over
    found = read_session(out.autosave, demo().points)
    assert torch.equal(found.session.state.points, editor.state.points)
    other = Editor(demo())
    other.resume(found.session)
    other.undo()
    other.undo()
    assert torch.equal(other.state.points, demo().points)
    with pytest.raises(EditError, match="other points"):
        read_session(out.autosave, made(100).points)
    out.edit.write_text("{}")
    out.forget()
    assert not out.left_over


def test_a_full_disk_at_save_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, editor = outputs(tmp_path), Editor(demo())
    editor.add("twist")
    out.keep(editor.session, [])
    before = out.autosave.read_bytes()

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    editor.add("bend")
    with pytest.raises(EditError, match="No space left"):
        out.keep(editor.session, [])
    with pytest.raises(EditError, match="No space left"):
        editor.session.save(tmp_path / "studio" / "edit.json")
    named = NamedSelections(folder=tmp_path / "studio", count=len(editor.asset.points))
    with pytest.raises(EditError, match="No space left"):
        named.keep("all", ~editor.mask)
    assert named.names == []
    assert out.autosave.read_bytes() == before
    assert len(editor.session.stack.edits) == 2


class Alone(Tabs):
    """Tabs without a page."""

    def __init__(self) -> None:
        self.failures: list[Exception] = []
        super().__init__(self.failures.append)
        self.editor = Editor(demo())
        self.worker.start()

    def _refresh(self) -> None: ...

    def _show_drag(self) -> None: ...

    def _show_working(self) -> None: ...

    def _let_go(self) -> None:
        self.editor.cancel()


class FakeViewport:
    """What `Tabs` needs to know of one."""

    def __init__(self, number: int) -> None:
        self.number, self.told = number, list[str]()
        self.client = self

    def add_notification(self, title: str, text: str, **_: Any) -> None:
        self.told.append(title)


@pytest.fixture
def alone() -> Any:
    tabs: Any = Alone()
    yield tabs
    tabs.worker.stop()


def test_of_two_tabs_one_edits_until_the_other_takes_over(alone: Any) -> None:
    first, second = FakeViewport(1), FakeViewport(2)
    assert alone._join(first)
    assert not alone._join(second)
    done: list[int] = []
    add = alone._wish(done.append)
    add(1, 1)
    add(2, 2)
    assert alone.worker.wait()
    assert done == [1]
    assert second.told == ["Another tab edits this object"]
    alone._take_over(2)
    assert alone.worker.wait()
    add(1, 1)
    add(2, 2)
    assert alone.worker.wait()
    assert done == [1, 2]


def test_a_browser_that_leaves_in_a_drag_has_not_let_go(alone: Any) -> None:
    alone._join(FakeViewport(1))
    alone._join(FakeViewport(2))
    editor = alone.editor
    editor.place_handle(10)
    x, y, z = editor.handles[0].place
    depth = editor.session.history.now
    editor.drag(HandlePose(place=(x, y, z + 0.1)))
    alone._leave(1)
    assert not editor.dragging
    assert editor.session.history.now == depth
    assert alone._owner == 2


def test_what_is_wished_faster_than_it_is_done_is_done_once(alone: Any) -> None:
    alone._join(FakeViewport(1))
    done: list[int] = []
    alone.worker.do(lambda: None)
    for number in range(200):
        alone.newest("slider", lambda number=number: done.append(number))
    assert alone.worker.wait()
    assert done[-1] == 199
    assert len(done) < 200


def test_errors_are_shown_without_folders_and_traces(alone: Any) -> None:
    alone._join(FakeViewport(1))

    def refuse() -> None:
        raise EditError("/home/anna/run/cage.ply: expected a mesh")

    alone.perform(refuse)
    assert alone.worker.wait()
    assert alone._said == "⚠ cage.ply: expected a mesh"
    alone.perform(lambda: 1 / 0)
    assert alone.worker.wait()
    assert alone._said == "⚠ ZeroDivisionError: see the terminal"
    assert len(alone.failures) == 1


def test_a_posed_object_is_the_one_that_was_asked_for_last() -> None:
    editor, drawer = Editor(demo()), Drawer(demo())
    editor.add("twist")
    editor.set(0, "angle_deg", 60.0)
    still = drawer.posed(editor.state, still=True)
    assert drawer.posed(editor.state, still=True) is still
    baked = drawer.posed(editor.state, still=False)
    assert baked is not still
    lit = replace(still, content=still.content)
    assert demo().gains_of(lit) is not None
    assert demo().gains_of(baked) is None

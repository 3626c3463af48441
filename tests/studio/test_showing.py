"""What comes to a tab in which order, without a tab."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from tests.seeded_runs import write_runs

import pcore
from pcore.asset.asset import Asset, Posed
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.studio.drawing import Drawer
from pcore.studio.editor import Editor
from pcore.studio.page_frame import PageFrame
from pcore.studio.showing import Showing


class FakeViewport:
    """Notes what it is shown."""

    def __init__(self, camera: Camera) -> None:
        self.eye, self._camera, self.shown = camera.center, camera, list[str]()
        self.dots, self.threads = 0, set[int]()

    def camera(self, *, most: int = 0) -> Camera:
        return self._camera

    def moving(self) -> None: ...

    def show_splats(self, splats: Any) -> None:
        self.shown.append("splats")
        self.threads.add(torch.get_num_threads())

    def show_picture(self, pixels: Any, depth: Any) -> None:
        self.shown.append("picture")
        self.threads.add(torch.get_num_threads())

    def show_dots(self, points: torch.Tensor, colors: torch.Tensor, folds: torch.Tensor) -> None:
        self.dots = len(points)


@pytest.fixture(scope="module")
def lit(tmp_path_factory: pytest.TempPathFactory) -> Asset:
    return pcore.load(write_runs(tmp_path_factory.mktemp("runs"))["lit"])


@pytest.fixture
def scene(lit: Asset) -> tuple[Editor, Drawer, FakeViewport, Showing]:
    editor, drawer = Editor(lit), Drawer(lit)
    editor.add("twist")
    editor.set(0, "angle_deg", 40.0)
    viewport = FakeViewport(orbit_around(editor.state.points, size=(24, 24))[0])
    return editor, drawer, viewport, Showing(editor, drawer, PageFrame.around(lit.points))


def test_the_first_picture_does_not_wait_for_the_light(
    scene: Any, lit: Asset, monkeypatch: pytest.MonkeyPatch
) -> None:
    editor, drawer, viewport, showing = scene
    find = Asset.lit

    def noted(self: Asset, posed: Posed, gains: torch.Tensor | None = None) -> Posed:
        viewport.shown.append("light" if gains is None else "light of before")
        return find(self, posed, gains)

    monkeypatch.setattr(Asset, "lit", noted)
    for _ in showing.rest([viewport], lambda: False):
        pass
    order = viewport.shown
    assert order.index("picture") < order.index("light") < len(order) - 1
    expected = lit.gains_of(lit.pose(editor.state, light="still"))
    assert expected is not None
    assert torch.equal(lit.gains_of(drawer.posed(editor.state, still=True)), expected)
    viewport.shown.clear()
    editor.set(0, "angle_deg", 50.0)
    steps = showing.rest([viewport], lambda: False)
    while "picture" not in viewport.shown:
        next(steps)
    assert viewport.shown[0] == "light of before", "no flash of another light"
    assert "light" not in viewport.shown, "a new wish ends it here"


@pytest.mark.parametrize("overlay", ["strain", "frozen"])
def test_an_overlay_stays_while_things_move(scene: Any, overlay: str) -> None:
    editor, _, viewport, showing = scene
    if overlay == "frozen":
        editor.set(0, "angle_deg", 1.0)
        editor.choose(torch.arange(len(editor.asset.points)) < 10)
        editor.freeze()
    editor.shown = replace(editor.shown, overlay=overlay)
    list(showing.rest([viewport], lambda: False))
    at_rest = viewport.dots
    assert at_rest > 0
    showing.move([viewport])
    assert viewport.dots == at_rest


def test_small_exact_pictures_while_things_move(scene: Any, lit: Asset) -> None:
    editor, drawer, viewport, showing = scene
    editor.shown = replace(editor.shown, moving="pictures, 100 pixels")
    showing.move([viewport])
    assert viewport.shown == ["picture"]
    posed = drawer.posed(editor.state, still=True)
    camera = viewport.camera()
    quick = drawer.quick_picture(editor.state, camera, still=True)
    assert torch.equal(quick.rgb, lit.render(posed, camera, fast=True).rgb)


@pytest.mark.parametrize(("moving", "threads"), [("splats", 1), ("pictures, 100 pixels", 2)])
def test_splats_leave_the_other_cores_to_the_browser(scene: Any, moving: str, threads: int) -> None:
    editor, _, viewport, showing = scene
    editor.shown = replace(editor.shown, moving=moving)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        showing.move([viewport])
        assert viewport.threads == {threads}
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)

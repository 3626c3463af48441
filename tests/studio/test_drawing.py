"""What tabs are shown of either kind of object."""

import numpy as np
import pytest
import torch
from tests.seeded_runs import write_runs

import pcore
from pcore.asset.asset import Asset
from pcore.geometry.orbit import orbit_around
from pcore.studio.drawing import Drawer
from pcore.studio.editor import Editor
from pcore.studio.packing import pack
from pcore.studio.recording import record
from pcore.studio.shown import OVERLAYS
from pcore.studio.viewport import side_by_side


@pytest.fixture(scope="module")
def papr(tmp_path_factory: pytest.TempPathFactory) -> Asset:
    return pcore.load(write_runs(tmp_path_factory.mktemp("runs"))["lit"])


def test_neural_points_are_splats_in_motion_and_exact_at_rest(papr: Asset) -> None:
    editor, drawer = Editor(papr), Drawer(papr)
    editor.add("twist")
    editor.set(0, "angle_deg", 20.0)
    camera = orbit_around(editor.state.points, size=(24, 24))[0]
    assert len(drawer.splats(editor.state, camera.center)) == len(papr)
    posed = drawer.posed(editor.state, still=True)
    *_, last = drawer.pictures(posed, camera, lambda: False)
    assert torch.equal(last.rgb, papr.render(posed, camera).rgb)


def test_pictures_that_nobody_wants_end(papr: Asset) -> None:
    editor, drawer = Editor(papr), Drawer(papr)
    camera = orbit_around(editor.state.points, size=(24, 24))[0]
    posed = drawer.posed(editor.state, still=True)
    assert list(drawer.pictures(posed, camera, lambda: True)) == []


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_every_overlay_is_drawn(papr: Asset, overlay: str) -> None:
    editor, drawer = Editor(papr), Drawer(papr)
    editor.add("twist")
    found = drawer.dots(editor.state, overlay, frozenset({1, 2}))
    assert len(found.points) == len(found.colors) >= 2


def test_neural_points_make_a_page(papr: Asset) -> None:
    packed = pack(record(papr, [papr.pose()]), 10**7)
    assert (packed.head["count"], packed.head["degree"]) == (len(papr), 0)


def test_two_pictures_stand_side_by_side() -> None:
    left, right = np.zeros((4, 8, 3), np.uint8), np.full((4, 8, 3), 255, np.uint8)
    both = side_by_side(left, right, 0.5)
    assert both[0, 0, 0] == 0
    assert both[0, 7, 0] == 255
    assert tuple(both[0, 4]) == (0, 150, 136)
    assert np.array_equal(side_by_side(left, right, 0.0), right)

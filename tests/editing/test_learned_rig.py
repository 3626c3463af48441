"""Edits by anchors with the weights that a run has learned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from tests.cli.toys import write_run

import pcore
from pcore.cli.main import main
from pcore.contrib.learned_skinning import SkinningConfig, untrained_skinning
from pcore.data.points import load_points
from pcore.deform.anchor_distance import path_distance
from pcore.editing.anchors import AnchorRig, rig_with
from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.regions import Setting
from pcore.editing.script import EditScript, parse_edit
from pcore.editing.session import EditSession
from pcore.errors import EditError
from pcore.files.skinning_file import SKINNING_FILE, save_skinning
from pcore.geometry.farthest_points import farthest_points

GENERATOR = torch.Generator().manual_seed(1)
BAR = (torch.rand(300, 3, generator=GENERATOR) * 2 - 1) * torch.tensor([1.0, 0.1, 0.1])
RIGID: dict[str, Any] = {"type": "rigid", "axis": "z", "angle_deg": 40, "translation": [1, 0, 2]}


def learned() -> AnchorRig:
    """Weights that no distance gives."""
    distance = path_distance(BAR, farthest_points(BAR, 30))
    skinning = untrained_skinning(distance, SkinningConfig(width=8))
    with torch.no_grad():
        skinning.network.layers[-1].weight.copy_(torch.randn(30, 8, generator=GENERATOR))
    return rig_with(skinning.paths, skinning)


RIG = learned()
RIGHT = int(RIG.graph.rest[:, 0].argmax())
DRAG: dict[str, Any] = {
    "type": "anchors",
    "count": 30,
    "handles": [{"anchor": RIGHT, "to": [0.9, 0.0, 0.5]}],
}


def script(*edits: dict[str, Any]) -> EditScript:
    return parse_edit({"version": 2, "edits": list(edits)})


def test_a_drag_uses_the_learned_weights() -> None:
    found = script(DRAG).bind(BAR, rig=RIG)(BAR.double())
    edit = AnchorsEdit.model_validate(DRAG)
    torch.testing.assert_close(found, edit.bind_to(RIG)(BAR.double()))
    by_distance = script(DRAG).bind(BAR)(BAR.double())
    assert float((found - by_distance).norm(dim=1).max()) > 0.01


@pytest.mark.parametrize("other", [{"count": 20}, {"seed": 5}])
def test_other_anchors_have_no_learned_weights(other: dict[str, int]) -> None:
    drag = DRAG | {"handles": [{"near": [0.9, 0.0, 0.0], "to": [0.9, 0.0, 0.5]}]} | other
    assert not RIG.is_of(count=drag["count"], seed=drag.get("seed", 0))
    found, plain = (script(drag).bind(BAR, rig=rig)(BAR.double()) for rig in (RIG, None))
    assert torch.equal(found, plain)


def test_points_keep_their_weights_after_other_edits() -> None:
    """A rigid motion first: the drag that moves along gives the moved result."""
    motion = script(RIGID).bind(BAR)
    to = motion(torch.tensor([[0.9, 0.0, 0.5]], dtype=torch.float64))[0].tolist()
    moved_drag = DRAG | {"handles": [{"anchor": RIGHT, "to": to}]}
    found = script(RIGID, moved_drag).bind(BAR, rig=RIG)(BAR.double())
    expected = motion(script(DRAG).bind(BAR, rig=RIG)(BAR.double()))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize("angle", [40.0, 80.0])
def test_anchors_without_learned_weights_stay_the_same_after_other_edits(angle: float) -> None:
    """Chosen anew on what an earlier edit made, they would jump from frame to frame."""
    bend = {"type": "bend", "axis": "z", "angle_deg": angle}
    moved = script(bend).bind(BAR)(BAR.double())
    edit = AnchorsEdit.model_validate(DRAG)
    chosen = edit.rig(Setting(points=moved, rest=BAR.double()))
    atrest = edit.rig(Setting(points=BAR.double(), rest=BAR.double()))
    places = [
        torch.cdist(one.graph.rest.double(), cloud.double()).argmin(dim=1)
        for one, cloud in ((chosen, moved), (atrest, BAR))
    ]
    assert torch.equal(*places)
    assert torch.equal(chosen.weights.values, atrest.weights.values)


def test_what_is_not_of_the_moved_cloud_follows_its_nearest_point() -> None:
    moved = script(RIGID).bind(BAR)(BAR.double())
    rig = RIG.at(moved)
    beside = rig.weigher(moved[:5].float() + 1e-4)
    assert torch.equal(beside.values, RIG.weights.values[:5])
    assert RIG.at(BAR) is RIG


def test_a_session_uses_them_too() -> None:
    state = EditSession(BAR, rig=RIG).do(DRAG)
    assert torch.equal(state.points, script(DRAG).bind(BAR, rig=RIG)(BAR.double()).float())


@pytest.mark.parametrize("points", [BAR + 1, BAR[:200]])
def test_points_of_another_run(points: torch.Tensor) -> None:
    with pytest.raises(EditError, match=r"edit 1 \(anchors\): learned skinning: expected the 300"):
        script(DRAG).bind(points, rig=RIG)


def test_a_run_without_skinning_has_none(tmp_path: Path) -> None:
    write_run(tmp_path / "run")
    assert pcore.load(tmp_path / "run").rig is None


def test_a_session_of_a_run_gives_the_points_of_the_commands(tmp_path: Path) -> None:
    run = tmp_path / "run"
    points = write_run(run, points=200)[1].positions
    distance = path_distance(points, farthest_points(points, 30))
    skinning = untrained_skinning(distance, SkinningConfig(width=8))
    with torch.no_grad():
        skinning.network.layers[-1].weight.copy_(torch.randn(30, 8, generator=GENERATOR))
    save_skinning(run / SKINNING_FILE, skinning)
    place = points[points[:, 0].argmax()]
    drag = {"near": place.tolist(), "to": (place + torch.tensor([0, 0, 0.3])).tolist()}
    edit = {"type": "anchors", "count": 30, "handles": [drag]}
    found = pcore.load(run).session().do(edit).points
    file, out = tmp_path / "edit.json", tmp_path / "moved.npy"
    script(edit).save(file)
    assert main(["edit", "apply", str(run), "--edit", str(file), "-o", str(out)]) == 0
    assert torch.equal(load_points(out), found)
    assert not torch.equal(EditSession(points).do(edit).points, found)

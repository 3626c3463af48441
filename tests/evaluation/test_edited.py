"""States that an edit file makes."""

import pytest
import torch

from pcore.editing.script import EditScript, parse_edit
from pcore.errors import InputError
from pcore.evaluation.edited import EditedShape
from pcore.evaluation.states import Shot
from pcore.geometry.camera import Camera

CENTER = torch.tensor([0.0, 0.0, 1.0])


def cloud(seed: int) -> torch.Tensor:
    return torch.rand(200, 3, generator=torch.Generator().manual_seed(seed)) - 0.5 + CENTER


def script(**edit: object) -> EditScript:
    return parse_edit({"version": 2, "edits": [edit]}, source="edit.json")


def shot() -> Shot:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([0.0, 0.0, 5.0])
    camera = Camera.from_fov(pose, width=20, height=20, angle_x=0.6)
    return Shot(view=None, camera=camera, depth=None)  # pyright: ignore


def test_every_cloud_is_moved_by_the_edit_as_bound_to_it() -> None:
    taper = script(type="taper", axis="z", factor=0.5)
    clouds = [cloud(1), 2 * cloud(2)]
    shape = EditedShape(taper, [(one, None) for one in clouds])
    state = shape.state("taper", [shot()], CENTER)
    assert (state.name, state.kind, state.has_truth) == ("edit:taper", "edited", False)
    for points in clouds:
        deformation = taper.bind(points)
        assert torch.equal(state.move(points), deformation(points.double()).float())
        maps = state.local_maps(points, state.move(points))
        assert maps is not None
        expected = torch.linalg.inv(deformation.jacobian(points.double())).float()
        torch.testing.assert_close(maps.to_rest, expected, rtol=1e-4, atol=1e-5)
    with pytest.raises(InputError, match="expected points that the edit was bound to"):
        state.move(cloud(3))


def test_cameras_step_back_where_the_object_grows_and_only_there() -> None:
    grown = script(type="scale", factor=3, origin=CENTER.tolist())
    state = EditedShape(grown, [(cloud(1), None)]).state("grown", [shot()], CENTER)
    torch.testing.assert_close(state.shots[0].camera.center, CENTER + torch.tensor([0, 0, 12.0]))
    shrunk = script(type="scale", factor=0.5, origin=CENTER.tolist())
    state = EditedShape(shrunk, [(cloud(1), None)]).state("shrunk", [shot()], CENTER)
    torch.testing.assert_close(state.shots[0].camera.center, CENTER + torch.tensor([0, 0, 4.0]))


def test_handles_and_notes_come_along() -> None:
    place = cloud(1)[0].tolist()
    handle = {"near": place, "to": [place[0], place[1], place[2] + 0.2]}
    drag = script(type="anchors", handles=[handle], count=60, reach=50)
    shape = EditedShape(drag, [(cloud(1), None)])
    state = shape.state("drag", [shot()], CENTER)
    assert state.handles is not None
    (found,) = state.handles(cloud(1))
    assert len(found.way) == 200
    assert bool((found.way > 0.02).all())
    assert shape.notes == ()

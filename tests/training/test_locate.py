"""Where the object is: box, files, masks, sparse points, axes, in that order."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from pcore.capture.load import load_scene
from pcore.data.pictures import to_bytes
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.geometry.object_region import Region, region_of_box
from pcore.training.hull import hull_points
from pcore.training.locate import locate
from room_scene import (
    RADIUS,
    cameras,
    moved_camera,
    picture,
    similarity,
    sparse_points,
    write_room,
)


@pytest.fixture
def room(tmp_path: Path) -> Scene:
    return load_scene(write_room(tmp_path / "room", 9))


def _masked(scene: Scene, masks: dict[str, Tensor]) -> Scene:
    views = {
        name: tuple(
            replace(view, image=replace(view.image, cut=to_bytes(masks[view.name])))
            for view in scene.split(name)
        )
        for name in scene.splits
    }
    return replace(scene, views=views)


def _true_masks(count: int) -> dict[str, Tensor]:
    return {f"{i:04d}": picture(camera)[1] for i, camera in enumerate(cameras(count))}


def test_without_anything_else_the_axes_tell(room: Scene) -> None:
    found = locate(room)
    assert found.source == "axes"
    assert found.scene is room


def test_the_users_box_goes_first(room: Scene) -> None:
    box = torch.tensor([[-1.0, -1.0, -0.5], [1.0, 1.0, 0.5]])
    found = locate(replace(room, region=Region(center=torch.ones(3), radius=1.0)), box)
    assert found.source == "box"
    assert torch.equal(torch.stack(found.region.bounds), box)


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]], "lower corner below an upper"),
        ([[0.0, 0.0, float("nan")], [1.0, 1.0, 1.0]], "lower corner below an upper"),
        ([[500.0, 500.0, 500.0], [501.0, 501.0, 501.0]], "none of 7 training views"),
    ],
)
def test_boxes_that_cannot_be_are_refused(room: Scene, box: list[list[float]], words: str) -> None:
    with pytest.raises(InputError, match=words):
        locate(room, torch.tensor(box))


def test_files_go_before_points(room: Scene) -> None:
    region = Region(center=torch.zeros(3), radius=1.0)
    found = locate(replace(room, region=region, sparse=sparse_points()))
    assert found.source == "files"
    assert found.scene.region is region


def test_sparse_points_tell_where_there_are_no_masks(room: Scene) -> None:
    found = locate(replace(room, sparse=sparse_points()))
    assert found.source == "points"
    assert float(found.region.bounds[1].min()) > 0.9 * RADIUS
    assert float(found.region.bounds[1].max()) < 1.3 * RADIUS


def test_masks_of_a_small_object_tell_where_it_is(room: Scene) -> None:
    masks = _true_masks(9)
    small = {name: torch.zeros_like(mask) for name, mask in masks.items()}
    for name, mask in small.items():
        mask[22:26, 30:34] = masks[name][22:26, 30:34]
    found = locate(_masked(room, small))
    assert found.source == "masks"
    assert found.scene.region is not None
    assert found.region.radius < 0.35 * room.radius
    assert float(found.region.center.norm()) < 0.1


def test_an_object_that_the_axes_hold_well_keeps_their_region(room: Scene) -> None:
    found = locate(_masked(room, _true_masks(9)))
    assert found.source == "axes"
    assert found.scene.region is None


def test_what_few_views_see_belongs_to_the_hull_in_a_known_region(room: Scene) -> None:
    # Four views of seven are turned away: most of them do not see the ball.
    scene = _masked(room, _true_masks(9))
    views = list(scene.split("train"))
    for number in range(4):
        camera = views[number].camera
        pose = camera.world_from_camera.clone()
        pose[:3, 0] *= -1
        pose[:3, 2] *= -1
        views[number] = replace(views[number], camera=camera.moved(pose))
    box = region_of_box(torch.full((3,), -1.0), torch.full((3,), 1.0))
    lower, upper = box.bounds
    generator = torch.Generator().manual_seed(0)
    points = hull_points(200, views, lower, upper, generator=generator, region=box)
    assert bool(box.contains(points).float().mean() > 0.9)


def test_units_do_not_matter(room: Scene) -> None:
    turn, shift, scale = motion = similarity()
    sparse = sparse_points()
    here = locate(replace(room, sparse=sparse)).region
    views = {
        name: tuple(
            replace(view, camera=moved_camera(view.camera, motion)) for view in room.split(name)
        )
        for name in room.splits
    }
    moved = replace(sparse, positions=scale * sparse.positions @ turn.T + shift)
    there = locate(replace(room, views=views, sparse=moved)).region
    # The box is along other axes of the object there: a ball's is the same but for its outliers.
    assert there.radius == pytest.approx(scale * here.radius, rel=0.03)
    place = scale * turn @ here.center + shift
    assert float((there.center - place).norm()) < 0.05 * there.radius

"""Starting clouds that the cameras do not see, or that masks have outside of the object."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.data.points import save_points
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.training.pretrain import pretrain
from pcore.training.start_cloud import check_start, report_start, start_from_file
from small_training import pretrain_config
from tiny_scene import CORNERS


def on_box(count: int = 400) -> Tensor:
    """Points in the box that the photos show."""
    draws = torch.rand(count, 3, generator=torch.Generator().manual_seed(1))
    lower, upper = (torch.from_numpy(f(CORNERS, 0)).float() for f in (_least, _most))
    return lower + draws * (upper - lower)


def _least(corners, axis):
    return corners.min(axis=axis)


def _most(corners, axis):
    return corners.max(axis=axis)


AWAY = torch.tensor([100.0, 100.0, 100.0])
UNSEEN = {
    "far away": lambda points: points + AWAY,
    "millimetres": lambda points: 1000 * points,
    "UTM": lambda points: points.double().add(5_412_345.0).float(),
    "a sky": lambda points: 60 * torch.nn.functional.normalize(points, dim=1),
    "another scene's box": lambda points: points - torch.tensor([0.0, 0.0, 30.0]),
}


@pytest.mark.parametrize("kind", UNSEEN)
def test_points_that_no_camera_sees_are_refused(box: Scene, tmp_path: Path, kind: str) -> None:
    points = UNSEEN[kind](on_box())
    message = (
        r"start.npy: [0-3] of 400 points lie in what the cameras see; are they in the coordinates "
        "of the cameras"
    )
    with pytest.raises(InputError, match=message):
        check_start(points, box.split("train"), "start.npy")
    save_points(tmp_path / "start.npy", points)
    with pytest.raises(InputError, match=message):
        pretrain(box, replace(pretrain_config(), start=str(tmp_path / "start.npy")))


OUTSIDE = {
    "unit cube of instant-ngp": lambda points: 0.33 * points[:, [1, 2, 0]] + 0.5,
    "other axis up": lambda points: points[:, [2, 0, 1]] * torch.tensor([1.0, 1.0, -1.0]),
    "three times as large": lambda points: 3 * points,
    "aside": lambda points: points + torch.tensor([0.5, 0.0, 0.0]),
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_points_outside_of_the_masks_are_told_of(box: Scene, kind: str) -> None:
    notes = check_start(OUTSIDE[kind](on_box()), box.split("train"), "start.npy")
    assert any("lie outside of the masks of views that see them" in note for note in notes)


def test_points_half_of_which_are_in_view_are_told_of(box: Scene) -> None:
    points = torch.cat([on_box(100), on_box(300) + AWAY])
    (note,) = check_start(points, box.split("train"), "start.npy")
    assert note.startswith("start.npy: 100 of 400 points lie in what the cameras see")


def test_points_on_the_object_have_no_notes(box: Scene) -> None:
    points = on_box()
    assert check_start(points, box.split("train"), "start.npy") == ()
    found = report_start(points, box.split("train"))
    assert (found.points, found.seen) == (400, 400)
    assert found.outside is not None
    assert found.outside < 10  # Pixels at the rim.


def test_a_cloud_of_few_points_on_the_object_is_no_error(box: Scene) -> None:
    assert check_start(on_box(1), box.split("train"), "start.npy") == ()


def test_a_grid_stands_where_the_cameras_look(box: Scene) -> None:
    away = []
    for view in box.split("train"):
        pose = view.camera.world_from_camera.clone()
        pose[:3, 3] += AWAY
        away.append(replace(view, camera=view.camera.moved(pose)))
    moved = replace(box, views={"train": tuple(away)})
    config = pretrain_config(start="grid", points=125, steps=1)
    here, there = (pretrain(scene, config).cloud.positions for scene in (box, moved))
    assert torch.allclose(there - AWAY, here, atol=2e-3)


def test_points_at_one_place_are_no_start(tmp_path: Path) -> None:
    np.save(tmp_path / "one.npy", np.ones((50, 3)))
    with pytest.raises(InputError, match="all 50 at one place"):
        start_from_file(tmp_path / "one.npy")

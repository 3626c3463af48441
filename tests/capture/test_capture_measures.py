"""What is measured of a capture: near poses, sharpness, exposure, coverage, reprojection."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.capture.coverage import coverage
from pcore.capture.load import load_scene
from pcore.capture.photo_quality import photo_quality
from pcore.capture.pose_contradictions import find_contradictions
from pcore.capture.reprojection import reprojection
from pcore.cli.cameras import OrbitWish, orbit_of_scene
from pcore.data.held_cameras import held_cameras
from pcore.data.scene import View
from pcore.data.sparse import Sightings, SparsePoints
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.object_region import Region
from pcore.geometry.orbit import orbit_cameras
from room_scene import HEIGHT, WIDTH, cameras, picture, write_room

BALL = Region(center=torch.zeros(3), radius=0.7)


def _views(folder: Path) -> list[View]:
    scene = load_scene(folder)
    found = [view for name in scene.splits for view in scene.split(name)]
    return sorted(found, key=lambda view: view.name)


def test_true_poses_do_not_contradict_one_another(tmp_path: Path) -> None:
    found = find_contradictions(_views(write_room(tmp_path / "room", 80)), BALL)
    assert len(found.pairs) >= 80
    assert found.usual is not None
    assert found.usual > 0.9
    assert found.contradicting == ()


def test_photos_at_each_others_poses_contradict_their_neighbours(tmp_path: Path) -> None:
    views = _views(write_room(tmp_path / "room", 80))
    # The second half of the walk is folded onto the first.
    folded = [replace(view, camera=views[number % 40].camera) for number, view in enumerate(views)]
    found = find_contradictions(folded, BALL)
    assert len(found.contradicting) > 5
    assert found.contradicting[0].alike < 0.5


def test_a_patterned_floor_behind_the_object_contradicts_nothing(tmp_path: Path) -> None:
    """Seen from above, near poses that are turned about the floor's normal, and far behind."""
    room = write_room(tmp_path / "room", 24)
    written = json.loads((room / "transforms.json").read_text())
    above = orbit_cameras(
        torch.zeros(3), 3.2, 24, elevation=1.45, width=WIDTH, height=HEIGHT, angle_x=0.9
    )
    for frame, camera in zip(written["frames"], above, strict=True):
        rays = camera.rays()
        down = (-0.7 - rays.origins[..., 2]) / rays.directions[..., 2]
        x, y, _ = (rays.origins + down.unsqueeze(-1) * rays.directions).unbind(-1)
        grey = 0.5 + 0.25 * torch.sin(9 * x + 2 * torch.sin(4 * y)) + 0.25 * torch.sin(11 * y + x)
        pixels = (255 * grey).round().byte().numpy()
        Image.fromarray(pixels).convert("RGB").save(room / frame["file_path"])
        frame["transform_matrix"] = camera.world_from_camera.tolist()
    (room / "transforms.json").write_text(json.dumps(written))
    views, near = _views(room), Region(center=torch.tensor([0.0, 0.0, 0.7]), radius=0.7)
    found = find_contradictions(views, near)
    assert sum(pair.alike < 0.6 for pair in found.pairs if pair.second - pair.first > 2) > 5
    assert found.contradicting == ()
    again = [replace(view, camera=above[(7 * k) % 24]) for k, view in enumerate(views)]
    assert len(find_contradictions(again, near).contradicting) > 5


def test_a_dark_photo_stands_out(tmp_path: Path) -> None:
    views = _views(write_room(tmp_path / "room", 80, dark=13))
    near = find_contradictions(views, BALL).pairs
    found = photo_quality(views, near)
    assert found.odd_exposure == (13,)
    assert float(found.stops[13].mean()) == pytest.approx(math.log2(0.4), abs=0.3)


def test_even_photos_do_not_stand_out(tmp_path: Path) -> None:
    views = _views(write_room(tmp_path / "room", 60))
    found = photo_quality(views, find_contradictions(views, BALL).pairs)
    assert found.odd_exposure == ()
    assert found.blurred == ()
    assert bool(found.compared.all())
    assert not found.drifts


def test_photos_too_far_apart_tell_nothing_of_exposure(tmp_path: Path) -> None:
    views = _views(write_room(tmp_path / "room", 20, dark=13))
    found = photo_quality(views, find_contradictions(views, BALL).pairs)
    assert found.odd_exposure == ()
    assert not bool(found.compared.any())


def test_a_blurred_photo_stands_out(tmp_path: Path) -> None:
    views = _views(write_room(tmp_path / "room", 20))
    path = views[7].image.path
    from PIL import Image, ImageFilter

    with Image.open(path) as image:
        image.filter(ImageFilter.GaussianBlur(2.5)).save(path)
    again = _views(tmp_path / "room")
    assert photo_quality(again, ()).blurred == (7,)


def test_a_ring_has_no_gap_and_half_of_it_one_of_half() -> None:
    ring = cameras(24)
    whole = coverage(ring, torch.zeros(3))
    assert whole.gap == pytest.approx(15, abs=0.1)
    assert float(whole.elevation.mean()) == pytest.approx(math.degrees(0.4), abs=0.1)
    half = coverage(ring[:12], torch.zeros(3))
    assert half.gap == pytest.approx(195, abs=30)
    assert half.sphere < whole.sphere


@pytest.mark.parametrize(("tag", "turns"), [(1, 0), (6, 1), (3, 2), (8, 3)])
def test_portraits_that_are_stored_lying_are_upright(tag: int, turns: int, tmp_path: Path) -> None:
    """Poses are of the stored pixels, as COLMAP writes them: a quarter to the left of the seen."""
    room = write_room(tmp_path / "room", 12)
    written = json.loads((room / "transforms.json").read_text())
    if turns % 2:
        written |= {"w": HEIGHT, "h": WIDTH, "cx": HEIGHT / 2, "cy": WIDTH / 2}
    quarter = torch.tensor([[0.0, 1.0], [-1.0, 0.0]])  # Right becomes the stored picture's down.
    for frame in written["frames"]:
        with Image.open(room / frame["file_path"]) as seen:
            stored = Image.fromarray(np.rot90(np.asarray(seen), turns))
            exif = Image.Exif()
            exif[0x112] = tag
        stored.save(room / frame["file_path"], exif=exif)
        pose = torch.tensor(frame["transform_matrix"])
        pose[:3, :2] = pose[:3, :2] @ torch.linalg.matrix_power(quarter, turns)
        frame["transform_matrix"] = pose.tolist()
    (room / "transforms.json").write_text(json.dumps(written))
    scene = load_scene(room)
    views = scene.split("train")
    seen, _ = picture(cameras(12)[1])
    torch.testing.assert_close(views[0].rgb(torch.ones(3)).rot90(-turns), seen, atol=0.003, rtol=0)
    axes = capture_axes(held_cameras(views))
    torch.testing.assert_close(axes[:, 2], torch.tensor([0.0, 0.0, 1.0]), atol=1e-5, rtol=0)

    for _, camera in orbit_of_scene(scene, OrbitWish(count=4)):
        assert float(camera.world_from_camera[2, 1]) > 0.8
        assert float(camera.world_from_camera[2, 0]) == pytest.approx(0, abs=1e-5)


def test_reprojection_is_in_pixels_of_the_files(tmp_path: Path) -> None:
    scene = load_scene(write_room(tmp_path / "room", 9), factor=2)
    views = [view for name in scene.splits for view in scene.split(name)]
    points = torch.tensor([[0.1, 0.2, 0.3], [-0.2, 0.1, 0.0]])
    column, row, _ = views[0].camera.project(points)
    places = torch.stack([column + 1.5, row], dim=-1)
    seen = Sightings(
        names=(views[0].name,),
        points=torch.tensor([0, 1]),
        views=torch.tensor([0, 0]),
        places=places,
    )
    found = reprojection(SparsePoints(positions=points, sightings=seen), views)
    assert found is not None
    assert found.mean == pytest.approx(3.0, abs=1e-3)
    assert reprojection(SparsePoints(positions=points), views) is None

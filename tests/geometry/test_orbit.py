"""Orbits: circles of cameras that look at a point with the right side up."""

from __future__ import annotations

import math

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import fitting_distance, growth, orbit_cameras, orbit_like

CENTER = torch.tensor([0.3, -0.2, 0.5])


def orbit(count: int = 6, **changes: object) -> list[Camera]:
    options: dict[str, object] = {
        "elevation": 0.4,
        "width": 8,
        "height": 6,
        "angle_x": 0.7,
    }
    distance = changes.pop("distance", 3.0)
    return orbit_cameras(CENTER, distance, count, **(options | changes))  # pyright: ignore


@pytest.mark.parametrize("up", [None, torch.tensor([0.0, 2.0, 0.0]), torch.tensor([1.0, 1, -1])])
@pytest.mark.parametrize("elevation", [-1.2, 0.0, 0.4])
def test_cameras_look_at_the_center_from_the_circle(
    up: torch.Tensor | None, elevation: float
) -> None:
    top = torch.tensor([0.0, 0.0, 1.0]) if up is None else up / up.norm()
    cameras = orbit(up=up, elevation=elevation)
    for camera in cameras:
        offset = camera.center - CENTER
        assert float(offset.norm()) == pytest.approx(3.0, abs=1e-5)
        assert math.asin(float(offset @ top) / 3) == pytest.approx(elevation, abs=1e-5)
        assert float(camera.depth(CENTER)) == pytest.approx(3.0, abs=1e-5)
        # The picture's right is level and its up points up.
        assert float(camera.world_from_camera[:3, 0] @ top) == pytest.approx(0, abs=1e-6)
        assert float(camera.world_from_camera[:3, 1] @ top) > 0
    steps = [
        float((a.center - b.center).norm())
        for a, b in zip(cameras, cameras[1:] + cameras[:1], strict=True)
    ]
    expected = 2 * 3 * math.cos(elevation) * math.sin(math.pi / 6)
    assert steps == pytest.approx([expected] * 6, abs=1e-5)


def test_an_orbit_about_z_begins_at_x_and_turns_towards_y() -> None:
    first, second, *_ = orbit(count=4, elevation=0.0)
    torch.testing.assert_close(first.center - CENTER, torch.tensor([3.0, 0, 0]), atol=1e-6, rtol=0)
    torch.testing.assert_close(second.center - CENTER, torch.tensor([0, 3.0, 0]), atol=1e-6, rtol=0)
    assert (first.width, first.height) == (8, 6)
    assert first.fx == pytest.approx(0.5 * 8 / math.tan(0.35))


def test_an_orbit_like_an_orbit_is_the_same() -> None:
    given = orbit(count=5)
    for a, b in zip(given, orbit_like(given, CENTER, 5), strict=True):
        torch.testing.assert_close(a.world_from_camera, b.world_from_camera, atol=1e-6, rtol=0)
        assert a.fx == pytest.approx(b.fx)


def test_an_orbit_like_cameras_has_their_mean_distance_and_elevation() -> None:
    given = [*orbit(3, elevation=0.2, distance=2.0), *orbit(3, elevation=0.6, distance=4.0)]
    made = orbit_like(given, CENTER, 7)
    assert len(made) == 7
    assert float((made[3].center - CENTER).norm()) == pytest.approx(3.0, abs=1e-5)
    height = float(made[3].center[2] - CENTER[2])
    assert math.asin(height / 3) == pytest.approx(0.4, abs=1e-5)


def test_cameras_straight_above_still_give_an_orbit() -> None:
    pose = torch.eye(4)
    pose[:3, 3] = CENTER + torch.tensor([0.0, 0.0, 2.0])
    above = Camera.from_fov(pose, width=8, height=6, angle_x=0.7)
    made = orbit_like([above], CENTER, 3)
    assert float(made[1].depth(CENTER)) == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 0}, "at least one camera, got 0"),
        ({"distance": 0.0}, "a positive distance in world units, got 0.0"),
        ({"distance": math.inf}, "a positive distance in world units, got inf"),
        ({"elevation": math.pi / 2}, "an elevation between -pi/2 and pi/2 radians"),
        ({"elevation": math.nan}, "an elevation between -pi/2 and pi/2 radians"),
        ({"up": torch.zeros(3)}, r"an up direction \(3,\) of finite length"),
        ({"angle_x": 4.0}, "field of view between 0 and pi radians, got 4.0"),
    ],
)
def test_bad_orbits(changes: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        orbit(**changes)  # pyright: ignore[reportArgumentType]


def test_an_orbit_needs_cameras_to_be_like() -> None:
    with pytest.raises(InputError, match="at least one camera to take its shape from"):
        orbit_like([], CENTER, 3)
    at_center = torch.eye(4)
    at_center[:3, 3] = CENTER
    camera = Camera.from_fov(at_center, width=8, height=6, angle_x=0.7)
    with pytest.raises(InputError, match="a positive distance"):
        orbit_like([camera], CENTER, 3)


def test_an_orbit_like_cameras_can_be_changed() -> None:
    given = orbit(4)
    made = orbit_like(given, CENTER, 4, elevation=0.1, scale=2.0, size=(16, 6))
    assert float((made[2].center - CENTER).norm()) == pytest.approx(6.0, abs=1e-5)
    assert math.asin(float(made[2].center[2] - CENTER[2]) / 6) == pytest.approx(0.1, abs=1e-5)
    assert (made[2].width, made[2].height) == (16, 6)
    assert made[2].fx == pytest.approx(2 * given[0].fx)


def test_points_at_the_fitting_distance_are_in_the_picture() -> None:
    points = torch.randn(200, 3) + CENTER
    distance = fitting_distance(points, CENTER, 0.7)
    for camera in orbit(5, distance=distance, width=20, height=20):
        local = (points - camera.center) @ camera.world_from_camera[:3, :3]
        pixels = 20 * 0.5 + camera.fx * local[:, :2] / -local[:, 2:]
        assert float(pixels.min()) > 0
        assert float(pixels.max()) < 20
    assert fitting_distance(points, CENTER, 1.4) < distance


def test_growth_is_how_much_farther_points_reach() -> None:
    points = torch.randn(50, 3)
    assert growth(points, CENTER + 3 * (points - CENTER), CENTER) == pytest.approx(3, abs=1e-5)
    assert growth(points, CENTER + 0.3 * (points - CENTER), CENTER) == 1
    assert growth(points[:1], points[:1], points[0]) == 1


def test_an_arc_goes_there_and_back_and_no_farther() -> None:
    given = orbit_cameras(CENTER, 3.0, 5, elevation=0.4, width=8, height=6, angle_x=0.7)
    middle, width = 0.5, 1.2
    found = orbit_like(given, CENTER, 8, arc=(middle, width))
    offsets = torch.stack([camera.center for camera in found]) - CENTER
    azimuth = torch.atan2(offsets[:, 1], offsets[:, 0]) - middle
    assert float(azimuth.abs().max()) == pytest.approx(width / 2, abs=1e-5)
    assert torch.allclose(azimuth[[0, 4]], torch.zeros(2), atol=1e-5)
    assert torch.allclose(azimuth[2], -azimuth[6], atol=1e-5)

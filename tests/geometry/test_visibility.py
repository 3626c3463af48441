"""What cameras see of balls: the half that faces them, nothing that another ball covers."""

import math

import pytest
import torch

from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.visibility import (
    cloud_spacing,
    seen_by,
    unseen_pixels,
    unseen_share,
    visible_from,
)


def ball(count: int = 4000, radius: float = 0.5) -> torch.Tensor:
    """Points spread evenly over a ball (Fibonacci's spiral)."""
    step = torch.arange(count).double() + 0.5
    z = 1 - 2 * step / count
    turn = math.pi * (1 + 5**0.5) * step
    across = (1 - z.square()).sqrt()
    return radius * torch.stack([across * turn.cos(), across * turn.sin(), z], dim=1)


def front(distance: float = 4.0) -> Camera:
    """A camera on the positive z axis that looks at the origin."""
    pose = torch.eye(4)
    pose[2, 3] = distance
    return Camera.from_fov(pose, width=100, height=100, angle_x=0.5)


def test_a_camera_sees_the_half_that_faces_it():
    points = ball()
    seen = seen_by(points, [front()])
    # A surface that is seen at a grazing angle has cells with more depth than the slack.
    assert bool(seen[points[:, 2] > 0.36].all())
    assert float(seen[points[:, 2] > 0.1].double().mean()) > 0.7
    assert not bool(seen[points[:, 2] < -0.15].any())


def test_spacing_is_that_of_an_even_ball():
    area = math.pi / 4000
    assert cloud_spacing(ball()) == pytest.approx(1.25 * math.sqrt(area), rel=0.1)


def test_cameras_all_around_see_everything():
    cameras = orbit_cameras(
        torch.zeros(3), 4.0, 12, elevation=0.4, width=50, height=50, angle_x=0.5
    )
    cameras += orbit_cameras(
        torch.zeros(3), 4.0, 12, elevation=-0.4, width=50, height=50, angle_x=0.5
    )
    assert bool(seen_by(ball(), cameras).all())
    assert not bool(seen_by(ball(), []).any())


def test_what_is_covered_outside_or_behind_is_not_seen():
    points = ball(radius=0.2)
    spacing = cloud_spacing(points)
    moves = {"covered": (0, 0, -1), "beside": (3, 0, 0), "behind": (0, 0, 5)}
    for where, move in moves.items():
        cloud = torch.cat([ball(radius=0.3), points + torch.tensor(move)])
        seen = visible_from(cloud, front(), spacing)
        assert bool(seen[:4000].any()), where
        assert not bool(seen[4000:].any()), where


def test_pixels_of_a_turned_ball_show_what_was_hidden():
    points, camera = ball(), front()
    unseen = points[:, 2] < 0
    spacing = cloud_spacing(points)
    middle = torch.cartesian_prod(torch.arange(100), torch.arange(100)).float() - 49.5
    alpha = (middle.norm(dim=1) < 24).float().reshape(100, 100)
    at_rest = unseen_pixels(points, unseen, camera, alpha, spacing)
    assert unseen_share(at_rest, alpha) < 0.02
    turned = points[:, [2, 1, 0]] * torch.tensor([1, 1, -1])  # A quarter turn about y.
    quarter = unseen_pixels(turned, unseen, camera, alpha, spacing)
    assert unseen_share(quarter, alpha) == pytest.approx(0.5, abs=0.03)
    assert not bool(quarter[alpha == 0].any())
    # The hidden half, z below 0 at rest, is now where x is below 0: on the left.
    assert bool(quarter[40:60, 28:45].all())
    assert not bool(quarter[40:60, 55:72].any())
    back = unseen_pixels(-points, unseen, camera, alpha, spacing)
    assert unseen_share(back, alpha) > 0.95


def test_nothing_to_see_is_no_share():
    points = ball(100)
    nothing = torch.zeros(100, 100)
    pixels = unseen_pixels(points, torch.ones(100).bool(), front(), nothing, 0.1)
    assert unseen_share(pixels, nothing) == 0
    away = points + torch.tensor([0, 0, 9])
    pixels = unseen_pixels(away, torch.ones(100).bool(), front(), nothing + 1, 0.1)
    assert unseen_share(pixels, nothing + 1) == 0


def test_bad_clouds():
    with pytest.raises(InputError, match="at least two points, got one"):
        seen_by(torch.zeros(1, 3), [front()])
    with pytest.raises(InputError, match="finite points"):
        seen_by(torch.full((5, 3), torch.nan), [front()])

"""The object among Gaussians of a room: near its true outline, the same in every unit."""

import torch
from torch import Tensor

from pcore.capture.gaussian_shape import GaussianShape, find_shape
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from room_scene import moved_camera, similarity

RADIUS = 0.6
HEIGHT = 0.9
"""Of the ball's middle before the wall."""


def blobs(means: Tensor, sizes: Tensor) -> Gaussians:
    count = len(means)
    return Gaussians(
        means=means,
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        scales=sizes[:, None].repeat(1, 3),
        opacities=torch.full((count,), 0.95),
        sh=torch.zeros(count, 1, 3),
    )


def room(with_ball: bool = True) -> Gaussians:
    """A floor z = 0 of 6 x 6, and a ball before it."""
    generator = torch.Generator().manual_seed(3)
    wall = torch.cat([6 * torch.rand(6000, 2, generator=generator) - 3, torch.zeros(6000, 1)], 1)
    ball = torch.nn.functional.normalize(torch.randn(3000, 3, generator=generator), dim=-1)
    ball = RADIUS * ball + torch.tensor([0.0, 0.0, HEIGHT])
    sizes = torch.cat([torch.full((len(wall),), 0.05), torch.full((len(ball),), 0.025)])
    whole = blobs(torch.cat([wall, ball]), sizes)
    return whole if with_ball else whole.each(lambda tensor: tensor[: len(wall)])


def cameras() -> list[Camera]:
    """On half a ring: all is seen from one side."""
    middle = torch.tensor([0.0, 0.0, HEIGHT])
    return orbit_cameras(middle, 3.0, 16, elevation=0.8, width=64, height=48, angle_x=0.9)[:8]


def ball_mask(camera: Camera) -> Tensor:
    rays = camera.rays()
    offset = rays.origins - torch.tensor([0.0, 0.0, HEIGHT])
    along = (offset * rays.directions).sum(-1)
    return along**2 - (offset**2).sum(-1) + RADIUS**2 > 0


def overlap(mask: Tensor, truth: Tensor) -> float:
    return float(((mask > 0.5) & truth).sum() / ((mask > 0.5) | truth).sum())


def found(gaussians: Gaussians, views: list[Camera]) -> GaussianShape | None:
    return find_shape(gaussians, Footprint(), views, torch.Generator().manual_seed(0))


def test_the_wall_is_taken_away_and_the_ball_stays() -> None:
    shape = found(room(), cameras())
    assert shape is not None
    assert float((shape.gaussians.means[:, 2] < 0.1).float().mean()) < 0.02
    overlaps = [overlap(shape.mask(camera), ball_mask(camera)) for camera in cameras()]
    # A pixel around the ball's rim, which the Gaussians reach over, is 15 % of its area.
    assert min(overlaps) > 0.7
    assert sum(overlaps) / len(overlaps) > 0.8


def test_a_room_in_other_units_has_the_same_object() -> None:
    turn, shift, scale = motion = similarity()
    here, gaussians = found(room(), cameras()), room()
    moved = Gaussians(
        means=scale * gaussians.means @ turn.T + shift,
        quats=gaussians.quats,  # They are round.
        scales=scale * gaussians.scales,
        opacities=gaussians.opacities,
        sh=gaussians.sh,
    )
    there = found(moved, [moved_camera(camera, motion) for camera in cameras()])
    assert here is not None
    assert there is not None
    masks = [(here.mask(c), there.mask(moved_camera(c, motion)) > 0.5) for c in cameras()]
    assert min(overlap(one, other) for one, other in masks) > 0.95


def test_a_bare_wall_has_no_object() -> None:
    assert found(room(with_ball=False), cameras()) is None


def test_parallel_axes_tell_of_nothing() -> None:
    camera = cameras()[0]
    assert found(room(), [camera, camera]) is None

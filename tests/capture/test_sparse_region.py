"""The object among the points of a reconstruction."""

import torch

from pcore.capture.sparse_region import object_points, region_of_points
from pcore.data.sparse import SparsePoints
from room_scene import RADIUS, ROOM, cameras, moved_camera, similarity, sparse_points


def test_the_object_is_found_and_the_room_is_not() -> None:
    points = object_points(sparse_points(), cameras())
    assert points is not None
    assert float(points.norm(dim=-1).max()) < 1.01 * RADIUS
    lower, upper = region_of_points(points).bounds
    assert bool((lower < -0.9 * RADIUS).all())
    assert bool((upper > 0.9 * RADIUS).all())
    assert float(upper.max()) < 1.3 * RADIUS


def test_units_do_not_matter() -> None:
    turn, shift, scale = motion = similarity()
    sparse = sparse_points()
    there = SparsePoints(positions=scale * sparse.positions @ turn.T + shift)
    here = object_points(sparse, cameras())
    again = object_points(there, [moved_camera(camera, motion) for camera in cameras()])
    assert here is not None
    assert again is not None
    assert torch.allclose(again, scale * here @ turn.T + shift, rtol=0, atol=2e-3 * scale)


def test_far_walls_alone_are_no_object() -> None:
    walls = torch.nn.functional.normalize(torch.randn(300, 3), dim=-1) * ROOM
    assert object_points(SparsePoints(positions=walls), cameras()) is None


def test_points_that_structure_from_motion_doubts_are_left_out() -> None:
    sparse = sparse_points()
    errors = torch.full((len(sparse),), 5.0)
    assert object_points(SparsePoints(positions=sparse.positions, errors=errors), cameras()) is None

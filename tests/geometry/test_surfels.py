"""The surface over points: where it lies at rest, and how it follows a pose."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine
from pcore.deform.pose import pose
from pcore.errors import InputError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels, spacing_of


def ball(count: int = 300) -> Tensor:
    draw = torch.Generator().manual_seed(1)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=draw), dim=1)


def turn(angle: float) -> Tensor:
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[1.0, 0, 0], [0, cos, -sin], [0, sin, cos]])


def test_the_surface_lies_above_the_points_and_moves_with_them() -> None:
    """Along the normal at rest; a pose carries it along as it does everything near a point."""
    points = ball()
    rest = Surfels.at_rest(points, points, torch.full((300,), 0.1))
    torch.testing.assert_close(rest.places, 1.1 * points)
    assert rest.spacing == spacing_of(points)
    matrix = torch.diag(torch.tensor([2.0, 1.0, 0.5])) @ turn(0.4)
    moved = points @ matrix.T + torch.tensor([3.0, 0.0, -1.0])
    maps = LocalMaps(to_rest=torch.linalg.inv(matrix).expand(300, 3, 3))
    found = rest.moved(moved, maps)
    torch.testing.assert_close(found.places, moved + 0.1 * points @ matrix.T)
    turned = torch.nn.functional.normalize(points @ torch.linalg.inv(matrix), dim=1)
    torch.testing.assert_close(found.normals, turned)
    # The mean of the axes' factors, 2, 1 and 1/2, is 1.
    assert found.spacing == pytest.approx(spacing_of(points))
    assert torch.equal(found.beside, rest.beside)
    assert torch.equal(found.heights, rest.heights)


def test_surfels_beside_a_point_are_those_of_the_rest_state_with_a_normal() -> None:
    points, normals = ball(), ball().clone()
    normals[::3] = 0
    flat = torch.zeros(300)
    rest = Surfels.at_rest(points, normals, flat)
    known = torch.nonzero(rest.known).squeeze(1)
    expected = known[torch.cdist(points, points[known]).argsort(dim=1)[:, :16]]
    assert torch.equal(rest.beside.sort(dim=1).values, expected.sort(dim=1).values)
    few = Surfels.at_rest(points, normals * (torch.arange(300) < 5)[:, None], flat)
    assert set(few.beside.flatten().tolist()) == {1, 2, 4}
    assert Surfels.at_rest(points, torch.zeros(300, 3), flat).beside.shape == (300, 0)


def test_where_space_folds_there_is_no_normal_any_more() -> None:
    """Plain rays draw such poses, too."""
    points = ball(4)
    rest = Surfels.at_rest(points, points, torch.full((4,), 0.1))
    maps = torch.eye(3).repeat(4, 1, 1)
    maps[1, 2, 2] = -1.0
    maps[2] = 0.0
    maps[3] = math.nan
    found = rest.moved(points, LocalMaps(to_rest=maps))
    assert found.known.tolist() == [True, False, False, False]
    assert torch.equal(found.places[1:], points[1:])
    cloud = PointCloud(positions=points, features=torch.zeros(4, 1), influence=torch.ones(4))
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    posed = pose(cloud, mirror, surfels=rest, aware=False)
    assert posed.surfels is not None
    assert not posed.surfels.known.any()


def test_poses_keep_all_parts_together() -> None:
    points = ball(2)
    cloud = PointCloud(positions=points, features=torch.zeros(2, 4), influence=torch.ones(2))
    surfels = Surfels.at_rest(points, points, torch.zeros(2))
    posed = replace(PosedCloud.at_rest(cloud, surfels), gains=torch.tensor([2.0, 0.5]))
    away = posed.to("meta")
    assert away.surfels is not None
    parts = (away.positions, away.surfels.places, away.surfels.beside, away.surfels.heights)
    assert {one.device.type for one in parts} == {"meta"}
    assert away.positions is away.cloud.positions
    assert posed.to("cpu") is posed
    none = Surfels.at_rest(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0))
    empty = PointCloud(
        positions=torch.zeros(0, 3), features=torch.zeros(0, 4), influence=torch.ones(0)
    )
    left = PosedCloud.at_rest(empty, none).to("meta").surfels
    assert left is not None
    assert left.places.device.type == "meta"
    with pytest.raises(InputError, match="surfels of its 2 points, got 3"):
        replace(posed, surfels=Surfels.at_rest(ball(3), ball(3), torch.zeros(3)))
    with pytest.raises(InputError, match="gains of its 2 points, got 3"):
        replace(posed, gains=torch.ones(3))
    with pytest.raises(InputError, match="surfels with gains, got gains alone"):
        replace(posed, surfels=None)
    with pytest.raises(InputError, match=r"positions of its 2 points, got \(3, 3\)"):
        replace(posed, positions=ball(3))


def test_surfels_are_checked() -> None:
    points = ball(2)
    for normals in (0.3 * points, math.nan * points):
        with pytest.raises(InputError, match="normals of unit length, or zero where not known"):
            Surfels.at_rest(points, normals, torch.zeros(2))
    for height in (math.nan, math.inf):
        with pytest.raises(InputError, match="finite heights"):
            Surfels.at_rest(points, points, torch.tensor([0.0, height]))
    whole = Surfels.at_rest(points, points, torch.zeros(2))
    with pytest.raises(InputError, match=r"heights \(N,\) and neighbours \(N, K\), got"):
        replace(whole, normals=torch.ones(3, 2))
    with pytest.raises(InputError, match=r"neighbours \(N, K\), got"):
        replace(whole, beside=torch.ones(2))

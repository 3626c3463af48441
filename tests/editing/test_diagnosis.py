"""Strain, thin places and self-intersection of known deformations."""

import math

import pytest
import torch

from pcore.deform.simple import Twist, rigid, uniform_scale
from pcore.editing.diagnosis import diagnose, with_exposed
from pcore.errors import InputError
from pcore.geometry.camera import Camera


def shell(center: float = 0.0, count: int = 2000) -> torch.Tensor:
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(2)).double()
    return torch.nn.functional.normalize(points, dim=-1) * 0.5 + torch.tensor([center, 0, 0])


def test_a_rigid_motion_is_calm():
    found = diagnose(shell(), rigid((1, 2, 3), 1.0, (5, 0, 0))(shell()))
    torch.testing.assert_close(found.strain, torch.ones(2000).double())
    assert found.hole_score == 0
    assert found.self_intersection == 0
    assert bool((found.colors() == 209).all())


@pytest.mark.parametrize("factor", [0.1, 3.0])
def test_a_scale_is_strain_and_nothing_else(factor: float):
    found = diagnose(shell(), uniform_scale(factor)(shell()))
    torch.testing.assert_close(found.strain, torch.full((2000,), factor).double())
    assert found.hole_score == 0
    assert found.hole_score_plain == (1.0 if factor > 2 else 0.0)
    torch.testing.assert_close(found.tearing, torch.ones(2000).double())
    assert found.self_intersection == 0
    assert bool((found.hole_colors() == 209).all())
    color = found.colors()[0].tolist()
    assert color == ([214, 38, 31] if factor > 2 else [33, 92, 199])


def test_a_stretch_shows_where_it_stretches():
    points = shell()
    moved = points.clone()
    moved[:, 0] = torch.where(points[:, 0] > 0, 3 * points[:, 0], points[:, 0])
    found = diagnose(points, moved)
    assert float(found.strain[points[:, 0] < -0.1].max()) == pytest.approx(1)
    assert float(found.strain[points[:, 0] > 0.1].median()) > 1.5
    assert float(found.strain.max()) == pytest.approx(3, abs=0.05)
    numbers = found.numbers()
    assert numbers["strain_max"] == float(found.strain.max())
    assert numbers["strain_median"] < numbers["strain_99"] <= numbers["strain_max"]


def test_a_smooth_map_tears_nothing_however_much_it_stretches():
    points = shell()
    stretched = points * torch.tensor([3.0, 1.0, 0.5]).double()
    twist = Twist(
        rotation=torch.eye(3), origin=torch.zeros(3), extent=(-0.5, 0.5), value=math.radians(90)
    )
    for moved in (stretched, twist(points)):
        found = diagnose(points, moved)
        assert float(found.strain.max()) > 1.3
        # The map around a point is fitted: one point of 2,000 where a sheet is pulled 6 to 1.
        assert found.hole_score < 0.001
        assert float(found.tearing.median()) < 1.05


def test_a_crack_is_a_hole_along_its_edge_and_nowhere_else():
    points = shell()
    moved = 1.3 * points
    moved[points[:, 2] > 0, 2] += 0.5
    found = diagnose(points, moved)
    torn = found.tearing > 2
    assert 0.05 < found.hole_score < 0.3
    assert not bool(torn[points[:, 2].abs() > 0.1].any())
    assert float(torn[points[:, 2].abs() < 0.02].double().mean()) > 0.8
    assert (found.hole_colors()[torn] == torch.tensor([237, 107, 13])).all()
    assert found.numbers()["hole_score"] == found.hole_score
    assert found.numbers()["hole_score_plain"] >= found.hole_score


def test_parts_pushed_into_each_other_meet():
    points = torch.cat([shell(-1), shell(1)])
    moved = points.clone()
    moved[2000:, 0] -= 1.4
    found = diagnose(points, moved)
    crossing = (moved[:, 0] + 0.7).abs() > 0.9
    assert 0.02 < found.self_intersection < 0.6
    assert not bool(found.meeting[crossing].any())
    assert found.hole_score == 0
    assert (found.colors()[found.meeting] == torch.tensor([191, 26, 191])).all()


def test_points_in_one_place_are_no_trouble():
    points = torch.zeros(20, 3)
    found = diagnose(points, points)
    assert found.strain.tolist() == found.tearing.tolist() == [1.0] * 20
    few = shell()[:3]
    assert diagnose(few, 3 * few).tearing.tolist() == [1.0] * 3


def test_points_that_all_went_to_one_place_have_no_holes():
    points = torch.rand(50, 3)
    found = diagnose(points, torch.ones(50, 3))
    assert float(found.tearing.max()) == 1.0
    assert found.hole_score == 0.0


def test_misfits_are_refused():
    with pytest.raises(InputError, match=r"the same points \(N, 3\) twice, at least two, got"):
        diagnose(shell(), shell()[:-1])


def test_a_lid_that_opens_exposes_what_it_covered():
    grid = torch.linspace(-0.5, 0.5, 40)
    floor = torch.cartesian_prod(grid, grid)
    floor = torch.cat([floor, torch.zeros(len(floor), 1)], dim=1)
    points = torch.cat([floor, floor + torch.tensor([0, 0, 0.3])])
    opened = points.clone()
    opened[1600:, 0] += 1.2
    pose = torch.eye(4)
    pose[2, 3] = 8.0
    above = Camera.from_fov(pose, width=50, height=50, angle_x=0.6)
    calm = diagnose(points, opened)
    assert calm.exposed is None
    assert "exposed" not in calm.numbers()
    found = with_exposed(calm, points, opened, [above])
    # The floor, but for the rim beside which the camera sees it past the lid.
    assert 0.42 < found.numbers()["exposed"] <= 0.5
    assert not bool(found.exposed[1600:].any())
    assert (found.colors()[found.exposed] == torch.tensor([250, 189, 5])).all()
    assert with_exposed(calm, points, points, [above]).numbers()["exposed"] == 0
    assert torch.equal(found.strain, calm.strain)

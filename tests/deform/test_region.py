"""Regions: what is inside, how they fade, and what an edit in one does to space."""

import math

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine, Compose, Deformation
from pcore.deform.frame import axis_vector
from pcore.deform.point_region import PointRegion, path_weights
from pcore.deform.region import Box, HalfSpace, Region, Sphere, Union, ramp
from pcore.deform.simple import rigid, uniform_scale
from pcore.deform.weighted import Held, Weighted
from pcore.errors import InputError
from pcore.geometry.neighbours import neighbour_graph

ZERO = torch.zeros(3)


def cloud(count: int = 400, seed: int = 3) -> Tensor:
    return 2 * torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)).double() - 1


def point_region() -> PointRegion:
    points = cloud(300, seed=9)
    return PointRegion(points, ramp((points[:, 0] - 0.1).clamp_min(0), 0.5))


REGIONS = {
    "box": Box(lower=torch.full((3,), -0.4), upper=torch.full((3,), 0.3), falloff=0.5),
    "sphere": Sphere(center=torch.full((3,), 0.1), radius=0.4, falloff=0.5),
    "half_space": HalfSpace(origin=ZERO, normal=axis_vector((1, 2, 0)), falloff=0.6),
    "union": Union(
        Sphere(center=ZERO, radius=0.3, falloff=0.5),
        HalfSpace(origin=torch.ones(3) * 0.4, normal=axis_vector("z"), falloff=0.4),
    ),
    "points": point_region(),
}
INNER = Compose(rigid((1, 2, 3), 0.5, (0.2, 0, 0)), uniform_scale(1.2))


@pytest.fixture(params=REGIONS.values(), ids=REGIONS.keys())
def region(request) -> Region:
    return request.param


def numeric(function, points: Tensor, step: float = 1e-6) -> Tensor:
    columns = [
        (function(points + step * unit) - function(points - step * unit)) / (2 * step)
        for unit in torch.eye(3, dtype=torch.float64)
    ]
    return torch.stack(columns, dim=-1)


def test_weights_reach_both_ends_exactly(region: Region):
    weight = region.weight(cloud())
    assert float(weight.min()) == 0.0
    assert float(weight.max()) == 1.0
    assert bool(((weight > 0) & (weight < 1)).any())
    assert region.weight(cloud().float()).dtype == torch.float32
    assert region.weight(cloud(24).reshape(2, 12, 3)).shape == (2, 12)
    assert region.weight(cloud()[:0]).shape == (0,)


def test_gradients_agree_with_finite_differences(region: Region):
    points = cloud()
    expected = numeric(region.weight, points)
    torch.testing.assert_close(region.gradient(points), expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["box", "sphere", "half_space", "union"])
def test_the_slope_has_no_jump(name: str):
    """Along a line the slope changes little from one small step to the next: the weight is C1."""
    region = REGIONS[name]
    along = torch.linspace(-1.5, 1.5, 20001, dtype=torch.float64)
    line = along[:, None] * axis_vector((1, 0.7, 0.4))
    slope = region.gradient(line)
    assert float(slope.norm(dim=-1).max()) > 1
    assert float(slope.diff(dim=0).norm(dim=-1).max()) < 0.01


def test_falloff_is_outside_the_shape_in_world_units():
    sphere = Sphere(center=ZERO, radius=1.0, falloff=0.5)
    x = torch.tensor([[0.0, 0, 0], [1, 0, 0], [1.25, 0, 0], [1.499, 0, 0], [1.5, 0, 0]]).double()
    weight = sphere.weight(x)
    assert weight[[0, 1, 4]].tolist() == [1.0, 1.0, 0.0]
    assert float(weight[2]) == pytest.approx(0.5)
    assert 0 < float(weight[3]) < 1e-6
    cut = Sphere(center=ZERO, radius=1.0, falloff=0.0)
    assert cut.weight(x).tolist() == [1.0, 1.0, 0.0, 0.0, 0.0]
    box = Box(lower=-torch.ones(3), upper=torch.ones(3), falloff=1.0)
    corner = torch.tensor([[1.3, 1.4, 0.0]]).double()
    torch.testing.assert_close(box.weight(corner), ramp(torch.tensor([0.5]).double(), 1.0))


def test_a_region_that_cuts_has_no_slope_on_its_face():
    box = Box(lower=-torch.ones(3), upper=torch.ones(3), falloff=0.0)
    face = torch.rand(20, 3, dtype=torch.float64)
    face[:, 0] = 1.0
    assert not bool(box.gradient(face).any())
    assert torch.equal(box.weight(face), torch.ones(20, dtype=torch.float64))


@pytest.mark.parametrize("falloff", [-0.1, math.nan, math.inf])
def test_bad_falloffs_are_refused(falloff: float):
    with pytest.raises(InputError, match="region falloff: expected a length of 0 or more"):
        Sphere(center=ZERO, radius=1.0, falloff=falloff)


def test_paths_keep_parts_apart_that_only_come_near():
    """A horseshoe: its ends are close in space and far over the surface."""
    angle = torch.linspace(0.1, 2 * math.pi - 0.1, 400, dtype=torch.float64)
    shoe = torch.stack([torch.cos(angle), torch.sin(angle), 0 * angle], dim=-1)
    weights = path_weights(neighbour_graph(shoe, 4), torch.tensor([0]), radius=0.5, falloff=0.3)
    assert float(weights[0]) == 1.0
    assert float(weights[-1]) == 0.0
    ball = Sphere(center=shoe[0], radius=0.5, falloff=0.3)
    assert float(ball.weight(shoe[-1:])) == 1.0
    region = PointRegion(shoe, weights)
    assert torch.equal(region.weight(shoe), weights)


def test_point_weights_must_fit():
    with pytest.raises(InputError, match="expected 400 weights between 0 and 1"):
        PointRegion(cloud(), torch.full((400,), 1.5))
    with pytest.raises(InputError, match="expected 400 weights between 0 and 1"):
        PointRegion(cloud(), torch.ones(3))


DEFORMATIONS = {
    **{name: Weighted(INNER, one, None) for name, one in REGIONS.items()},
    "frozen": Weighted(INNER, None, REGIONS["sphere"]),
    "both": Weighted(INNER, REGIONS["half_space"], REGIONS["sphere"]),
    "held": Held((INNER, Weighted(INNER, REGIONS["box"], None), INNER), REGIONS["sphere"]),
    "held_points": Held((INNER, INNER), REGIONS["points"]),
}


@pytest.mark.parametrize("name", DEFORMATIONS)
def test_jacobians(name: str):
    deformation, points = DEFORMATIONS[name], cloud()
    jacobian = deformation.jacobian(points)
    torch.testing.assert_close(jacobian, numeric(deformation, points), rtol=1e-5, atol=2e-5)
    automatic = Deformation.jacobian(deformation, points)
    torch.testing.assert_close(jacobian, automatic, rtol=1e-9, atol=1e-9)
    some = points[:5].clone().requires_grad_(True)
    loss = deformation.jacobian(some).square().sum() + deformation(some).sum()
    (gradient,) = torch.autograd.grad(loss, some)
    assert bool(torch.isfinite(gradient).all())
    assert deformation(points.float()).dtype == torch.float32
    assert deformation.jacobian(points[:0]).shape == (0, 3, 3)


def test_an_edit_in_a_region_is_the_edit_inside_and_nothing_outside():
    points, region = cloud(), REGIONS["sphere"]
    moved, weight = Weighted(INNER, region, None)(points), region.weight(points)
    assert torch.equal(moved[weight == 1], INNER(points)[weight == 1])
    assert torch.equal(moved[weight == 0], points[weight == 0])


def test_the_way_of_points_is_found_once_for_places_and_jacobians():
    asked = list[int]()

    class Grown(Deformation):
        factor = torch.tensor(1.1, dtype=torch.float64)

        def __call__(self, points: Tensor) -> Tensor:
            asked.append(len(points))
            return self.factor * points

        def jacobian(self, points: Tensor) -> Tensor:
            return (self.factor * torch.eye(3, dtype=points.dtype)).expand(*points.shape, 3)

    grown, points = Weighted(Grown(), REGIONS["sphere"]), cloud()
    first, _ = grown(points), grown.jacobian(points)
    assert asked == [len(points)]
    points += 0.01
    assert not torch.equal(grown(points), first), "other places in the same tensor"
    with torch.no_grad():
        grown(points)
    Grown.factor.requires_grad_()
    assert grown(points).requires_grad
    assert grown(points.float()).dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_is_held_stays_exactly(dtype: torch.dtype):
    points = cloud().to(dtype)
    held = Held((INNER, rigid("z", 2.0), INNER), REGIONS["sphere"])
    weight = REGIONS["sphere"].weight(points)
    assert bool((weight == 1).any())
    assert torch.equal(held(points)[weight == 1], points[weight == 1])
    eye = torch.eye(3, dtype=dtype).expand(int((weight == 1).sum()), 3, 3)
    assert torch.equal(held.jacobian(points)[weight == 1], eye)
    free = Compose(INNER, rigid("z", 2.0), INNER)
    assert torch.equal(held(points)[weight == 0], free(points)[weight == 0])


def test_passing_through_what_is_held_stops_nothing():
    hold = Sphere(center=torch.tensor([1.0, 0, 0]), radius=0.1, falloff=0.1)
    shift = rigid(translation=(1, 0, 0))
    there = Held((shift, shift), hold)(torch.zeros(1, 3))
    assert there.tolist() == [[2.0, 0.0, 0.0]]


def test_folds_count_where_the_edit_acts():
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), ZERO)
    points, region = cloud(), REGIONS["sphere"]
    weight = region.weight(points)
    folded = Weighted(mirror, region, None).folded(points)
    assert bool(folded[weight == 1].all())
    assert not bool(folded[weight == 0].any())
    twice = Held((mirror, mirror), region)
    assert bool(twice.folded(points)[weight == 0].all())
    assert not bool(twice.folded(points)[weight == 1].any())

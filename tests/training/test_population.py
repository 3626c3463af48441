"""Where points start, which ones go, where new ones come."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor, nn

from pcore.errors import InputError, TrainingError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.training.hull import faint_share, grid_points, hull_points
from pcore.training.population import growth_mixture, growth_sites, replace_rows
from small_training import FakeView

# --- grid -------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [2, 3, 4, 5, 6, 7])
def test_a_cube_number_of_points_is_the_whole_grid(side: int) -> None:
    lower, upper = torch.tensor([-1.0, -2.0, 0.0]), torch.tensor([1.0, 2.0, 0.5])
    points = grid_points(side**3, lower, upper)
    assert points.shape == (side**3, 3)
    for axis in range(3):
        values = points[:, axis].unique()
        assert torch.allclose(values, torch.linspace(float(lower[axis]), float(upper[axis]), side))
    assert len(points.unique(dim=0)) == side**3


def test_a_grid_is_thinned_evenly() -> None:
    half = torch.full((3,), 1.2)
    points = grid_points(3000, -half, half)
    assert points.shape == (3000, 3)
    assert len(points.unique(dim=0)) == 3000
    assert torch.equal(points.amin(dim=0), -half)
    assert torch.equal(points.amax(dim=0), half)
    assert points.mean(dim=0).abs().max() < 0.02
    # Cutting off the tail instead would leave a corner of the cube empty.
    assert int((points > 0.5).all(dim=1).sum()) > 40


# --- visual hull ------------------------------------------------------------------------------

CENTER, RADIUS = torch.tensor([0.3, -0.2, 0.1]), 0.7


def ball(camera: Camera, center: Tensor = CENTER) -> FakeView:
    rays = camera.rays()
    offset = center - rays.origins
    along = (offset * rays.directions).sum(dim=-1, keepdim=True)
    distance = (offset - along * rays.directions).norm(dim=-1)
    return FakeView(camera, (distance < RADIUS).float().unsqueeze(-1).expand(-1, -1, 4))


def cameras(count: int, elevation: float) -> list[Camera]:
    return orbit_cameras(
        torch.zeros(3), 4.0, count, elevation=elevation, width=64, height=48, angle_x=0.8
    )


def around(center: Tensor = CENTER) -> list[FakeView]:
    return [
        ball(camera, center)
        for elevation in (-1.2, -0.6, 0.0, 0.6, 1.2)
        for camera in cameras(8, elevation)
    ]


def hull(views: list[FakeView], count: int = 2000, seed: int = 0) -> Tensor:
    box = torch.full((3,), 1.3)
    generator = torch.Generator().manual_seed(seed)
    return hull_points(count, views, -box, box, generator=generator, resolution=48)


def test_the_hull_of_a_ball_is_the_ball() -> None:
    points = hull(around())
    distance = (points - CENTER).norm(dim=1)
    # A pixel is 0.05 wide, a voxel 0.03; the hull of 40 views bulges a little.
    assert distance.min() > RADIUS - 0.08
    assert distance.max() < RADIUS + 0.12
    assert distance.mean() == pytest.approx(RADIUS, abs=0.04)


PLATE = torch.tensor([1.0, 0.01, 1.0])


def with_plate(camera: Camera) -> FakeView:
    """The ball in a square plate thinner than a pixel, as photos show it: with soft edges."""
    rays = camera.resized(4 * camera.width, 4 * camera.height).rays()
    start, direction = rays.origins - CENTER, rays.directions
    near = start - (start * direction).sum(dim=-1, keepdim=True) * direction
    sides = torch.stack([(side * PLATE - start) / direction for side in (-1, 1)])
    enters, leaves = sides.amin(dim=0).amax(dim=-1), sides.amax(dim=0).amin(dim=-1)
    hit = (near.norm(dim=-1) < 0.4) | (enters < leaves)
    cover = nn.functional.avg_pool2d(hit.float()[None], 4)[0]
    return FakeView(camera, cover.unsqueeze(-1).expand(-1, -1, 4))


def test_a_sheet_thinner_than_a_pixel_has_points() -> None:
    """Views from its edge cover no pixel of it by half; they must not carve it away."""
    views = [with_plate(camera) for height in (-0.6, 0.0, 0.6) for camera in cameras(8, height)]
    edge_on = with_plate(cameras(1, 0.0)[0])
    middle = edge_on.alpha()[:, 12:20].amax()
    assert 0.1 < float(middle) < 0.5
    offset = hull(views) - CENTER
    out = (offset[:, [0, 2]].abs().amax(dim=1) > 0.5) & (offset[:, 1].abs() < 0.06)
    # Four fifths of the points' surface is the plate outside of the ball.
    assert float(out.float().mean()) > 0.5
    corners = offset[out][:, [0, 2]]
    for sign in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        assert int((corners * torch.tensor(sign) > 0.7).all(dim=1).sum()) > 10


def test_the_hull_is_covered_all_over() -> None:
    directions = nn.functional.normalize(hull(around()) - CENTER, dim=1)
    probes = nn.functional.normalize(torch.randn(200, 3), dim=1)
    assert (probes @ directions.T).amax(dim=1).min() > math.cos(math.radians(15))


def test_points_of_the_hull_are_drawn_from_the_generator() -> None:
    views = around()[::4]
    assert torch.equal(hull(views, 50), hull(views, 50))
    assert not torch.equal(hull(views, 50), hull(views, 50, seed=1))


def test_views_do_not_carve_what_they_do_not_see() -> None:
    seeing = cameras(8, 0.0)[0]
    blind = replace(seeing, world_from_camera=seeing.world_from_camera.clone())
    blind.world_from_camera[:3, 3] *= -1.0  # Upright, on the other side, and looks away.
    views = around()[::3]
    shown = torch.zeros(48, 64, 4)
    shown[0, 0] = 1  # Masks that hold nothing carve nothing in any case.
    with_blind = [*views, FakeView(blind, shown)]
    apart = torch.cdist(hull(with_blind), hull(views))  # Voxels may lie along other axes.
    assert float(apart.amin(dim=1).max()) < 0.2
    assert float(apart.amin(dim=0).max()) < 0.2


def test_a_lost_mask_carves_nothing() -> None:
    views = around()[::3]
    lost = replace(views[2].camera, world_from_camera=views[2].camera.world_from_camera.clone())
    found = hull([*views[:2], FakeView(lost, torch.zeros(48, 64, 4)), *views[3:]])
    assert float((found - CENTER).norm(dim=1).max()) < RADIUS + 0.3
    with pytest.raises(TrainingError, match="no common inside"):
        hull([FakeView(view.camera, torch.zeros(48, 64, 4)) for view in views])


def test_what_no_view_sees_is_no_object() -> None:
    """Corners of the searched box that lie outside of all pictures."""
    far = torch.full((3,), 3.5)
    generator = torch.Generator().manual_seed(0)
    points = hull_points(500, around()[::4], -far, far, generator=generator, resolution=64)
    assert (points - CENTER).norm(dim=1).max() < 2 * RADIUS


def test_faint_pixels_are_counted_per_solid_one() -> None:
    def flat(*opacities: float) -> FakeView:
        rgba = torch.tensor(opacities).reshape(1, -1, 1).expand(-1, -1, 4)
        return FakeView(cameras(1, 0.0)[0], rgba)

    clean, hazy = flat(1.0, 0.6, 0.5, 0.04), flat(1.0, 0.06, 0.3, 0.5)
    assert faint_share([clean]) == 0.5
    assert faint_share([hazy]) == 3.0
    assert faint_share([clean, hazy, hazy]) == 3.0
    assert faint_share([flat(0.1, 0.2)]) == 2.0, "nothing solid"
    assert faint_share(around()) < 0.3


def test_silhouettes_without_a_common_inside() -> None:
    views = around()[::4] + around(-3 * CENTER)[::4]
    with pytest.raises(TrainingError, match=r"masks have no common inside.*start from a grid"):
        hull(views)


# --- replacing rows under Adam -----------------------------------------------------------------


def fit(parameter: nn.Parameter, target: Tensor, optimizer: torch.optim.Optimizer) -> None:
    """One step on a loss whose rows know nothing of each other."""
    optimizer.zero_grad()
    difference = (parameter - target).reshape(len(target), -1)
    difference.square().sum(dim=1).sqrt().sum().backward()
    optimizer.step()


@pytest.mark.parametrize("fused", [True, False])
def test_surviving_rows_train_on_as_if_nothing_had_happened(fused: bool) -> None:
    start, target = torch.randn(20, 3), torch.randn(20, 3)
    keep = torch.rand(20) > 0.4
    reference, pruned = nn.Parameter(start.clone()), nn.Parameter(start.clone())
    whole = torch.optim.Adam([reference], lr=0.05, fused=fused)
    other = nn.Parameter(torch.ones(2, 3))
    adam = torch.optim.Adam([{"params": [other]}, {"params": [pruned]}], lr=0.05, fused=fused)
    for _ in range(7):
        fit(reference, target, whole)
        fit(pruned, target, adam)
    pruned = replace_rows(adam, pruned, keep, torch.zeros(4, 3))
    assert pruned.shape == (int(keep.sum()) + 4, 3)
    padded = torch.cat([target[keep], torch.ones(4, 3)])
    for _ in range(5):
        fit(reference, target, whole)
        fit(pruned, padded, adam)
    assert torch.allclose(pruned[:-4], reference[keep], rtol=1e-6, atol=1e-7)
    assert not torch.equal(pruned[-4:], torch.zeros(4, 3))
    assert adam.param_groups[0]["params"][0] is other
    assert adam.param_groups[1]["params"][0] is pruned


def test_new_rows_have_no_moments_and_old_ones_keep_theirs() -> None:
    parameter = nn.Parameter(torch.randn(6))
    adam = torch.optim.Adam([parameter], lr=0.1, fused=True)
    for _ in range(3):
        fit(parameter, torch.zeros(6), adam)
    before = dict(adam.state[parameter])
    keep = torch.tensor([True, False, True, True, False, True])
    replaced = replace_rows(adam, parameter, keep, torch.tensor([5.0, 6.0]))
    after = adam.state[replaced]
    assert parameter not in adam.state
    rows = torch.cat([parameter.detach()[keep], torch.tensor([5.0, 6.0])])
    assert torch.equal(replaced.detach(), rows)
    for name in ("exp_avg", "exp_avg_sq"):
        assert before[name].abs().min() > 0
        assert torch.equal(after[name], torch.cat([before[name][keep], torch.zeros(2)]))
    assert float(after["step"]) == 3


def test_rows_can_be_replaced_before_the_first_step() -> None:
    parameter = nn.Parameter(torch.randn(4, 2))
    adam = torch.optim.Adam([parameter], lr=0.1)
    replaced = replace_rows(adam, parameter, torch.ones(4, dtype=torch.bool), torch.zeros(1, 2))
    fit(replaced, torch.ones(5, 2), adam)
    assert torch.allclose(replaced[-1], torch.full((2,), 0.1), atol=1e-4)


# --- growing ----------------------------------------------------------------------------------


def test_growth_happens_where_distances_to_neighbours_differ_most() -> None:
    points = torch.randn(80, 3)
    distance = torch.cdist(points, points).sort(dim=1).values[:, 1:11]
    expected = distance.std(dim=1, unbiased=False).topk(15).indices
    assert torch.equal(growth_sites(points, 15), expected)


def test_more_sites_than_points_are_taken_in_turn() -> None:
    points = torch.randn(12, 3)
    sites = growth_sites(points, 30)
    assert torch.equal(sites[:12].sort().values, torch.arange(12))
    assert torch.equal(sites[12:24], sites[:12])


def test_growing_needs_neighbours() -> None:
    with pytest.raises(InputError, match="expected more than 10 points, got 10"):
        growth_sites(torch.randn(10, 3), 1)


def test_new_points_lie_between_the_three_nearest_neighbours() -> None:
    points, sites = torch.randn(50, 3), torch.tensor([4, 4, 30, 7])
    parents, weights = growth_mixture(points, sites, torch.Generator().manual_seed(0))
    nearest = torch.cdist(points[sites], points).sort(dim=1).indices[:, 1:4]
    assert torch.equal(parents.sort(dim=1).values, nearest.sort(dim=1).values)
    assert weights.min() >= 0
    assert torch.allclose(weights.sum(dim=1), torch.ones(4))
    assert not torch.equal(weights[0], weights[1])
    again = growth_mixture(points, sites, torch.Generator().manual_seed(0))
    assert torch.equal(again[1], weights)

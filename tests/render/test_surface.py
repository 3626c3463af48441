"""The surface point of a picture lies on one layer of points."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.model.attention import Attended
from pcore.render.surface import middle_surface, surface_of


def cloud_at(depths: list[float], beside: list[float] | None = None) -> PointCloud:
    """Points along z."""
    positions = torch.zeros(len(depths), 3)
    positions[:, 2] = torch.tensor(depths)
    if beside is not None:
        positions[:, 0] = torch.tensor(beside)
    return PointCloud(
        positions=positions, features=torch.zeros(len(depths), 1), influence=torch.ones(len(depths))
    )


def attended(cloud: PointCloud, weights: list[list[float]]) -> Attended:
    each = torch.tensor(weights)
    return Attended(
        features=torch.zeros(len(each), 1),
        background=torch.zeros(len(each)),
        weights=each,
        surface=each @ cloud.positions,
        behind=torch.zeros(len(each)),
    )


def depths_of(cloud: PointCloud, weights: list[list[float]], cutoff: float | None) -> list[float]:
    rows = len(weights)
    rays = RayBundle(
        origins=torch.tensor([[0.0, 0.0, -5.0]]).expand(rows, 3),
        directions=torch.tensor([[0.0, 0.0, 1.0]]).expand(rows, 3),
    )
    neighbours = torch.arange(len(cloud)).expand(rows, -1)
    points = surface_of(cloud, rays, attended(cloud, weights), neighbours, cutoff).surface
    return points[:, 2].tolist()


def test_two_layers_are_not_averaged() -> None:
    cloud = cloud_at([3.0, 0.0, 0.1, 3.1])
    # What is in front counts from a fifth of the weight on.
    weights = [[0.35, 0.15, 0.15, 0.35], [0.4, 0.09, 0.09, 0.42], [0.5, 0.0, 0.0, 0.5]]
    behind = (0.4 * 3.0 + 0.42 * 3.1) / 0.82
    assert depths_of(cloud, weights, 0.5) == pytest.approx([0.05, behind, 3.05])
    means = [2.15, 2.511, 3.05]
    assert depths_of(cloud, weights, None) == pytest.approx(means)
    assert depths_of(cloud, weights, 10.0) == pytest.approx(means)


def test_one_layer_is_its_mean() -> None:
    cloud = cloud_at([0.1, 0.3, 0.2], beside=[0.0, 0.1, -0.1])
    weights = [[0.5, 0.25, 0.25], [0.0, 0.0, 1.0]]
    assert depths_of(cloud, weights, 0.5) == pytest.approx([0.175, 0.2])


def test_a_ray_without_attention_has_no_surface() -> None:
    cloud = cloud_at([0.1, 0.3])
    found = depths_of(cloud, [[0.0, 0.0], [1.0, 0.0]], 0.5)
    assert math.isnan(found[0])
    assert found[1] == pytest.approx(0.1)
    assert math.isnan(depths_of(cloud, [[0.0, 0.0]], None)[0])


def test_layers_are_as_thick_as_at_rest() -> None:
    """An object drawn larger keeps its surface: distances are those of the rest state."""
    rest = cloud_at([0.0, 0.4, 1.0])
    weights = [[0.3, 0.3, 0.4]]
    small = depths_of(rest, weights, 0.5)
    assert small == pytest.approx([0.2])
    frames = LocalMaps(rest=rest.positions, to_rest=torch.eye(3).expand(3, 3, 3) / 10)
    assert depths_of(rest.moved(10 * rest.positions, frames), weights, 0.5) == pytest.approx([2.0])
    assert depths_of(rest.moved(10 * rest.positions), weights, 0.5) == pytest.approx([0.0])


def test_what_lies_nearer_along_the_ray_comes_first_also_in_other_orders() -> None:
    cloud = cloud_at([2.0, 1.0, 0.0])
    assert depths_of(cloud, [[0.7, 0.2, 0.1]], 0.5) == pytest.approx([1.0])


def test_with_a_skin_the_first_layer_is_met_in_its_own_light() -> None:
    """Points at 0 and 3 along the ray, planes half a unit before them; cut-offs tell layers."""
    cloud = cloud_at([3.0, 0.0, 0.1, 3.1])
    skin = Surfels(
        places=cloud.positions - torch.tensor([0.0, 0.0, 0.5]),
        normals=torch.tensor([[0.0, 0.0, -1.0]]).expand(4, 3),
        beside=torch.tensor([[0, 3], [1, 2], [1, 2], [0, 3]]),
        spacing=1.0,
        gains=torch.tensor([2.0, 0.5, 0.5, 2.0]),
    )
    weights = [[0.35, 0.15, 0.15, 0.35], [0.4, 0.09, 0.09, 0.42], [0.0, 0.0, 0.0, 0.0]]
    rays = RayBundle(
        origins=torch.tensor([[0.0, 0.0, -5.0]]).expand(3, 3),
        directions=torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3),
    )
    neighbours = torch.arange(4).expand(3, -1)

    def depths_and_gains(
        skin: Surfels | None, cutoff: float | None
    ) -> tuple[list[float], list[float] | None]:
        met = attended(cloud, weights)
        found = surface_of(cloud.covered(skin), rays, met, neighbours, cutoff)
        return found.surface[:, 2].tolist(), None if found.gains is None else found.gains.tolist()

    behind = (0.4 * 2.5 + 0.42 * 2.6) / 0.82
    depths, gains = depths_and_gains(skin, 0.5)
    assert depths[:2] == pytest.approx([-0.45, behind])
    assert math.isnan(depths[2])
    assert gains == pytest.approx([0.5, 2.0, 1.0])
    # Without a cut-off all is one layer, as it is without a skin.
    assert depths_and_gains(skin, None)[0][:2] == pytest.approx([1.65, 2.011])
    # As deep as the points where it is asked for, in the same light.
    depths, gains = depths_and_gains(replace(skin, deep=False), 0.5)
    assert depths[:2] == pytest.approx([0.05, behind + 0.5])
    assert gains == pytest.approx([0.5, 2.0, 1.0])
    double = PointCloud(
        positions=cloud.positions.double(), features=cloud.features, influence=cloud.influence
    )
    lines = RayBundle(origins=rays.origins.double(), directions=rays.directions.double())
    met = attended(cloud, weights)
    met = replace(met, surface=met.surface.double(), weights=met.weights.double())
    found = surface_of(double.covered(skin), lines, met, neighbours, 0.5)
    assert found.surface.dtype == torch.float64
    assert found.surface[:2, 2].tolist() == pytest.approx([-0.45, behind])
    depths, none = depths_and_gains(replace(skin, gains=None), 0.5)
    assert depths[:2] == pytest.approx([-0.45, behind])
    assert none is None
    assert depths_and_gains(None, 0.5)[1] is None


@pytest.mark.parametrize("moved", [False, True])
def test_the_kernel_of_the_cpu_finds_the_same_layer(
    moved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw = torch.Generator().manual_seed(5)
    cloud = PointCloud(
        positions=torch.rand(200, 3, generator=draw),
        features=torch.zeros(200, 1),
        influence=torch.ones(200),
    )
    if moved:
        frames = LocalMaps(rest=cloud.positions, to_rest=torch.eye(3).expand(200, 3, 3))
        cloud = cloud.moved(torch.rand(200, 3, generator=draw), frames)
    weights = torch.rand(400, 9, generator=draw).pow(3)
    weights[:, 6] = 0
    weights[::11] = 0
    weights = weights / weights.sum(dim=1, keepdim=True).clamp_min(1e-9)
    ahead = torch.nn.functional.normalize(torch.randn(400, 3, generator=draw), dim=1)
    rays = RayBundle(origins=0.5 - 3 * ahead, directions=ahead)
    neighbours = torch.randint(0, 200, (400, 9), generator=draw)
    met = Attended(
        features=torch.zeros(400, 1),
        background=torch.zeros(400),
        weights=weights,
        surface=torch.zeros(400, 3),
        behind=torch.zeros(400),
    )
    found = surface_of(cloud, rays, met, neighbours, 0.4).surface
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    expected = surface_of(cloud, rays, met, neighbours, 0.4).surface
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5, equal_nan=True)
    whole = surface_of(cloud, rays, met, neighbours, None).surface
    apart = (expected - (weights.unsqueeze(2) * cloud.positions[neighbours]).sum(dim=1)).norm(dim=1)
    assert float(apart.nanmedian()) > 0.05, "most rays meet several layers"
    assert whole.shape == found.shape


def test_no_gradient_and_no_change_of_what_the_losses_see() -> None:
    cloud = cloud_at([0.0, 3.0])
    met = attended(cloud, [[0.6, 0.4]])
    weights = met.weights.clone().requires_grad_()
    rays = RayBundle(origins=torch.zeros(1, 3), directions=torch.tensor([[0.0, 0.0, 1.0]]))
    met = replace(met, weights=weights)
    found = surface_of(cloud, rays, met, torch.tensor([[0, 1]]), 0.5).surface
    assert not found.requires_grad
    assert float(met.surface[0, 2]) == pytest.approx(1.2)


def test_of_several_rays_the_middle_one_is_taken() -> None:
    surface = torch.zeros(2, 4, 3)
    surface[0, :, 2] = torch.tensor([4.0, 1.0, 2.0, 3.0])
    surface[1] = math.nan
    surface[1, 2] = torch.tensor([0.0, 0.0, 7.0])
    found = middle_surface(surface, torch.zeros(2, 4, 3))
    assert found[:, 2].tolist() == [2.0, 7.0]

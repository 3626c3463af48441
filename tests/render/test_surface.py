"""The surface point of a picture lies on one layer of points."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.model.hits import Hits
from pcore.render.surface import middle_surface, surface_of


def cloud_at(depths: list[float], beside: list[float] | None = None) -> PosedCloud:
    """Points along z."""
    positions = torch.zeros(len(depths), 3)
    positions[:, 2] = torch.tensor(depths)
    if beside is not None:
        positions[:, 0] = torch.tensor(beside)
    count = len(depths)
    return PosedCloud.at_rest(
        PointCloud(positions=positions, features=torch.zeros(count, 1), influence=torch.ones(count))
    )


def hits_of(posed: PosedCloud, weights: list[list[float]]) -> Hits:
    each = torch.tensor(weights)
    return Hits(
        neighbours=torch.arange(len(posed)).expand(len(each), -1),
        weights=each,
        background=torch.zeros(len(each)),
        features=torch.zeros(len(each), 1),
        centroid=each @ posed.positions,
        spread=torch.zeros(len(each)),
    )


def depths_of(posed: PosedCloud, weights: list[list[float]], cutoff: float | None) -> list[float]:
    rows = len(weights)
    rays = RayBundle(
        origins=torch.tensor([[0.0, 0.0, -5.0]]).expand(rows, 3),
        directions=torch.tensor([[0.0, 0.0, 1.0]]).expand(rows, 3),
    )
    points, _ = surface_of(posed, rays, hits_of(posed, weights), cutoff)
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
    maps = LocalMaps(to_rest=torch.eye(3).expand(3, 3, 3) / 10)
    plain = replace(rest, positions=10 * rest.positions)
    assert depths_of(replace(plain, local_maps=maps), weights, 0.5) == pytest.approx([2.0])
    assert depths_of(plain, weights, 0.5) == pytest.approx([0.0])


def test_what_lies_nearer_along_the_ray_comes_first_also_in_other_orders() -> None:
    cloud = cloud_at([2.0, 1.0, 0.0])
    assert depths_of(cloud, [[0.7, 0.2, 0.1]], 0.5) == pytest.approx([1.0])


def test_with_surfels_the_first_layer_is_met_in_its_own_light() -> None:
    """Points at 0 and 3 along the ray, planes half a unit before them; cut-offs tell layers."""
    posed = cloud_at([3.0, 0.0, 0.1, 3.1])
    surfels = Surfels(
        places=posed.positions - torch.tensor([0.0, 0.0, 0.5]),
        normals=torch.tensor([[0.0, 0.0, -1.0]]).expand(4, 3),
        heights=torch.full((4,), 0.5),
        beside=torch.tensor([[0, 3], [1, 2], [1, 2], [0, 3]]),
        spacing=1.0,
    )
    lit = replace(posed, surfels=surfels, gains=torch.tensor([2.0, 0.5, 0.5, 2.0]))
    weights = [[0.35, 0.15, 0.15, 0.35], [0.4, 0.09, 0.09, 0.42], [0.0, 0.0, 0.0, 0.0]]
    rays = RayBundle(
        origins=torch.tensor([[0.0, 0.0, -5.0]]).expand(3, 3),
        directions=torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3),
    )

    def depths_and_gains(
        posed: PosedCloud, cutoff: float | None
    ) -> tuple[list[float], list[float] | None]:
        places, gains = surface_of(posed, rays, hits_of(posed, weights), cutoff)
        return places[:, 2].tolist(), None if gains is None else gains.tolist()

    behind = (0.4 * 2.5 + 0.42 * 2.6) / 0.82
    depths, gains = depths_and_gains(lit, 0.5)
    assert depths[:2] == pytest.approx([-0.45, behind])
    assert math.isnan(depths[2])
    assert gains == pytest.approx([0.5, 2.0, 1.0])
    # Without a cut-off all is one layer, as it is without surfels.
    assert depths_and_gains(lit, None)[0][:2] == pytest.approx([1.65, 2.011])
    double = lit.each(lambda one: one.double() if one.is_floating_point() else one)
    lines = rays.each(lambda one: one.double())
    hits = hits_of(posed, weights)
    hits = replace(hits, centroid=hits.centroid.double(), weights=hits.weights.double())
    found, _ = surface_of(double, lines, hits, 0.5)
    assert found.dtype == torch.float64
    assert found[:2, 2].tolist() == pytest.approx([-0.45, behind])
    # Depth does not depend on the light.
    depths, none = depths_and_gains(replace(lit, gains=None), 0.5)
    assert depths[:2] == pytest.approx([-0.45, behind])
    assert none is None
    assert depths_and_gains(posed, 0.5)[1] is None


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
    posed = PosedCloud.at_rest(cloud)
    if moved:
        maps = LocalMaps(to_rest=torch.eye(3).expand(200, 3, 3))
        posed = replace(posed, positions=torch.rand(200, 3, generator=draw), local_maps=maps)
    weights = torch.rand(400, 9, generator=draw).pow(3)
    weights[:, 6] = 0
    weights[::11] = 0
    weights = weights / weights.sum(dim=1, keepdim=True).clamp_min(1e-9)
    ahead = torch.nn.functional.normalize(torch.randn(400, 3, generator=draw), dim=1)
    rays = RayBundle(origins=0.5 - 3 * ahead, directions=ahead)
    hits = Hits(
        neighbours=torch.randint(0, 200, (400, 9), generator=draw),
        weights=weights,
        background=torch.zeros(400),
        features=torch.zeros(400, 1),
        centroid=torch.zeros(400, 3),
        spread=torch.zeros(400),
    )
    found, _ = surface_of(posed, rays, hits, 0.4)
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    expected, _ = surface_of(posed, rays, hits, 0.4)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5, equal_nan=True)
    whole, _ = surface_of(posed, rays, hits, None)
    places = posed.positions[hits.neighbours]
    apart = (expected - (weights.unsqueeze(2) * places).sum(dim=1)).norm(dim=1)
    assert float(apart.nanmedian()) > 0.05, "most rays meet several layers"
    assert whole.shape == found.shape


def test_the_surface_has_a_gradient_and_what_losses_see_is_another() -> None:
    posed = cloud_at([0.0, 3.0])
    hits = hits_of(posed, [[0.6, 0.4]])
    weights = hits.weights.clone().requires_grad_()
    rays = RayBundle(origins=torch.zeros(1, 3), directions=torch.tensor([[0.0, 0.0, 1.0]]))
    found, _ = surface_of(posed, rays, replace(hits, weights=weights), 0.5)
    assert found.requires_grad
    assert float(hits.centroid[0, 2]) == pytest.approx(1.2)


def test_of_several_rays_the_middle_one_is_taken() -> None:
    surface = torch.zeros(2, 4, 3)
    surface[0, :, 2] = torch.tensor([4.0, 1.0, 2.0, 3.0])
    surface[1] = math.nan
    surface[1, 2] = torch.tensor([0.0, 0.0, 7.0])
    found = middle_surface(surface, torch.zeros(2, 4, 3))
    assert found[:, 2].tolist() == [2.0, 7.0]

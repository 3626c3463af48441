"""What rays look at: a search that a pixel's rays share, and edits that are one affine map."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine
from pcore.deform.pose import pose
from pcore.deform.simple import Twist
from pcore.geometry.camera import Camera
from pcore.geometry.pixel_samples import grid_places
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.render import trace as trace_module
from pcore.render.trace import layer_of, search

K, CUTOFF = 6, 0.1


def ball(count: int = 3000) -> PosedCloud:
    draw = torch.Generator().manual_seed(1)
    places = torch.nn.functional.normalize(torch.randn(count, 3, generator=draw), dim=-1)
    return PosedCloud.at_rest(
        PointCloud(
            positions=0.6 * places, features=torch.zeros(count, 2), influence=torch.ones(count)
        )
    )


def pixels(size: int) -> RayBundle:
    """Four rays (P, 4) for each of the pixels of a picture that the ball fills half."""
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = Camera.from_fov(pose, width=size, height=size, angle_x=0.8)
    return camera.rays(places=grid_places(4)).by_pixel()


def twisted(posed: PosedCloud) -> PosedCloud:
    about_z = Twist(rotation=torch.eye(3), origin=torch.zeros(3), extent=(-0.6, 0.6), value=1.0)
    return pose(posed.cloud, about_z)


def looked(posed: PosedCloud, rays: RayBundle) -> tuple[Tensor, Tensor, RayBundle]:
    """Neighbours (R, k) of all rays, rays (M,) that may meet them, and those as points see them."""
    nearest, ray_of_near, candidates = search(posed, rays, K, CUTOFF)
    lines = rays.flat()[ray_of_near]
    neighbours, seen, _ = layer_of(posed, lines, candidates, K, CUTOFF)
    return nearest.index_copy(0, ray_of_near, neighbours), ray_of_near, seen


def same(one: Tensor, other: Tensor, rows: Tensor) -> float:
    """Share of some rays (M,) that have the same neighbours (R, k) in both."""
    pairs = one[rows].sort(dim=-1).values == other[rows].sort(dim=-1).values
    return float(pairs.all(dim=-1).float().mean())


@pytest.mark.parametrize("size", [16, 64])
def test_rays_that_share_a_search_find_what_they_would_alone(
    size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wide pixels (16) do not share, narrow ones do.

    Without layers: of those more slots are filled where more candidates are at hand.
    """
    monkeypatch.setattr(trace_module, "CLOSE", 0.0)
    posed, rays = twisted(ball()), pixels(size)
    shared, of_shared, seen = looked(posed, rays)
    alone, of_alone, _ = looked(posed, rays.flat())
    both = of_alone[torch.isin(of_alone, of_shared)]
    assert len(of_shared) > 0.2 * len(alone)
    assert len(both) > 0.98 * len(of_alone)
    # Neither search is exact: both choose among candidates.
    assert same(shared, alone, both) > 0.98
    assert seen.shape == (len(of_shared), K)


def test_narrow_pixels_search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the test above would find a search that is shared by pixels that are too wide."""
    searched: list[int] = []
    whole = trace_module.nearest_to_rays

    def counted(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
        searched.append(len(origins))
        return whole(origins, directions, points, k)

    monkeypatch.setattr(trace_module, "nearest_to_rays", counted)
    posed, rays = twisted(ball()), pixels(64)
    search(posed, rays, K, CUTOFF)
    assert searched[0] == 64**2
    assert sum(searched) < 1.5 * 64**2
    monkeypatch.setattr(trace_module, "WIDEST", 1e9)
    wide = pixels(16)
    found, rows, _ = looked(posed, wide)
    assert same(found, looked(posed, wide.flat())[0], rows) < 0.9


def test_without_a_cutoff_every_ray_is_near() -> None:
    posed, rays = ball(40), pixels(8)
    for moved in (posed, twisted(posed)):
        nearest, ray_of_near, candidates = search(moved, rays, K, None)
        assert torch.equal(ray_of_near, torch.arange(256))
        assert nearest.shape == (256, K)
        assert len(candidates) == 256


def test_one_map_for_all_points_asks_the_rest_state() -> None:
    matrix = torch.tensor([[0.2, 0.1, 0.0], [0.0, 1.5, 0.3], [0.0, 0.0, 1.0]])
    offset = torch.tensor([0.3, -1.0, 0.2])
    posed, rays = ball(), pixels(32).flat()
    moved = pose(posed.cloud, Affine(matrix, offset))
    directions = torch.nn.functional.normalize(rays.directions @ matrix.T, dim=-1)
    carried = RayBundle(origins=rays.origins @ matrix.T + offset, directions=directions)
    rest, rows, _ = looked(posed, rays)
    found, of_found, seen = looked(moved, carried)
    assert same(rest, found, rows) > 0.99
    assert seen.shape == (len(of_found),)
    back = torch.linalg.cross(seen.directions, rays.directions[of_found])
    assert float(back.norm(dim=-1).max()) < 1e-5

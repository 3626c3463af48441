"""What rays look at: a search that a pixel's rays share, and edits that are one affine map."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine
from pcore.deform.simple import Twist
from pcore.editing.apply import deformed_cloud
from pcore.geometry.camera import Camera
from pcore.geometry.pixel_samples import grid_places
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.rays import RayBundle
from pcore.kernels.ray_layers import LayerRules
from pcore.model import sight as sight_module
from pcore.render.sight import Sight, look

K, CUTOFF = 6, 0.1


def ball(count: int = 3000) -> PointCloud:
    draw = torch.Generator().manual_seed(1)
    places = torch.nn.functional.normalize(torch.randn(count, 3, generator=draw), dim=-1)
    return PointCloud(
        positions=0.6 * places, features=torch.zeros(count, 2), influence=torch.ones(count)
    )


def pixels(size: int) -> RayBundle:
    """Four rays (P, 4) for each of the pixels of a picture that the ball fills half."""
    pose = torch.eye(4)
    pose[2, 3] = 3.0
    camera = Camera.from_fov(pose, width=size, height=size, angle_x=0.8)
    rays = camera.rays(places=grid_places(4))
    return RayBundle(
        origins=rays.origins.reshape(-1, 4, 3), directions=rays.directions.reshape(-1, 4, 3)
    )


def twisted(cloud: PointCloud) -> PointCloud:
    about_z = Twist(rotation=torch.eye(3), origin=torch.zeros(3), extent=(-0.6, 0.6), value=1.0)
    return deformed_cloud(cloud, about_z)


def same(one: Sight, other: Sight) -> Tensor:
    """(M,) bool, the near rays of `one` that have the same neighbours in `other`."""
    rows = one.neighbours[one.near].sort(dim=-1).values
    return (rows == other.neighbours[one.near].sort(dim=-1).values).all(dim=-1)


@pytest.mark.parametrize("size", [16, 64])
def test_rays_that_share_a_search_find_what_they_would_alone(
    size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wide pixels (16) do not share, narrow ones do.

    Without layers: of those more slots are filled where more candidates are at hand.
    """
    monkeypatch.setattr(
        sight_module, "layer_rules", lambda _: LayerRules(close=0, apart=1, cutoff=1)
    )
    cloud, rays = twisted(ball()), pixels(size)
    shared, alone = (look(cloud, one, K, CUTOFF) for one in (rays, rays.flat()))
    assert torch.equal(shared.near, alone.near)
    assert len(shared.near) > 0.2 * len(alone.neighbours)
    # Neither search is exact: both choose among candidates.
    assert float(same(shared, alone).float().mean()) > 0.98
    assert shared.seen.shape == (len(shared.near), K)


def test_narrow_pixels_search_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the test above would find a search that is shared by pixels that are too wide."""
    searched: list[int] = []
    search = sight_module.nearest_to_rays

    def counted(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
        searched.append(len(origins))
        return search(origins, directions, points, k)

    monkeypatch.setattr(sight_module, "nearest_to_rays", counted)
    cloud, rays = twisted(ball()), pixels(64)
    look(cloud, rays, K, CUTOFF)
    assert searched[0] == 64**2
    assert sum(searched) < 1.5 * 64**2
    monkeypatch.setattr(sight_module, "_APART", 1e9)
    wide = pixels(16)
    found = look(cloud, wide, K, CUTOFF)
    assert float(same(found, look(cloud, wide.flat(), K, CUTOFF)).float().mean()) < 0.9


def test_without_a_cutoff_every_ray_is_near() -> None:
    cloud, rays = ball(40), pixels(8)
    for moved in (cloud, twisted(cloud)):
        sight = look(moved, rays, K, None)
        assert torch.equal(sight.near, torch.arange(256))
        assert sight.neighbours.shape == (256, K)


def test_one_map_for_all_points_asks_the_rest_state() -> None:
    matrix = torch.tensor([[0.2, 0.1, 0.0], [0.0, 1.5, 0.3], [0.0, 0.0, 1.0]])
    offset = torch.tensor([0.3, -1.0, 0.2])
    cloud, rays = ball(), pixels(32).flat()
    moved = deformed_cloud(cloud, Affine(matrix, offset))
    directions = torch.nn.functional.normalize(rays.directions @ matrix.T, dim=-1)
    carried = RayBundle(origins=rays.origins @ matrix.T + offset, directions=directions)
    rest, found = look(cloud, rays, K, CUTOFF), look(moved, carried, K, CUTOFF)
    assert float(same(rest, found).float().mean()) > 0.99
    assert found.seen.shape == (len(found.near),)
    back = torch.linalg.cross(found.seen.directions, rays.directions[found.near])
    assert float(back.norm(dim=-1).max()) < 1e-5

"""What is asked of an object wrongly is said so, and never drawn as something else."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from tests.cli.toys import CONFIG, toy_cameras, toy_cloud

import pcore
from gaussian_asset import asset_of_gaussians
from pcore.asset.asset import Asset
from pcore.asset.saving import asset_of
from pcore.deform.simple import uniform_scale
from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.camera import Camera
from pcore.model.papr import Papr


@pytest.fixture(params=["neural points", "gaussians"])
def asset(request: pytest.FixtureRequest) -> Asset:
    cloud = toy_cloud()
    if request.param == "neural points":
        return asset_of(Papr(CONFIG).requires_grad_(False).eval(), cloud)
    count = len(cloud)
    return asset_of_gaussians(
        Gaussians(
            means=cloud.positions,
            quats=torch.eye(4)[:1].repeat(count, 1),
            scales=torch.full((count, 3), 0.05),
            opacities=torch.full((count,), 0.8),
            sh=torch.zeros(count, 1, 3),
        )
    )


@pytest.fixture
def camera() -> Camera:
    return toy_cameras(1, size=8)[0]


@pytest.mark.parametrize("names", [{"rays": "awear"}, {"light": "stil"}])
def test_a_name_with_a_slip_of_the_pen(asset: Asset, names: Any) -> None:
    ((what, wrong),) = names.items()
    with pytest.raises(InputError, match=f"{what}: expected one of .*, got {wrong!r}"):
        asset.pose(uniform_scale(1.2), **names)


def test_points_that_are_torn_to_nan(asset: Asset, camera: Camera) -> None:
    positions = asset.points.clone()
    positions[3] = math.nan
    with pytest.raises(InputError, match=r"NaN or infinity in .*1 of "):
        asset.render(asset.pose(pcore.MovedPoints(positions=positions)), camera)


def test_rays_that_are_no_unit_vectors_or_none_at_all(asset: Asset, camera: Camera) -> None:
    rays = camera.rays()
    longer = replace(rays, directions=2 * rays.directions)
    with pytest.raises(InputError, match="of unit length, got lengths up to 2"):
        asset.trace(None, longer)
    with pytest.raises(InputError, match="of unit length, got no rays"):
        asset.trace(None, rays[:0])


def test_rays_that_are_no_picture_for_networks(camera: Camera) -> None:
    points = asset_of(Papr(CONFIG).requires_grad_(False).eval(), toy_cloud())
    for rays in (camera.rays()[0], camera.rays()[:3]):
        with pytest.raises(InputError, match="at least 4 x 4 of them"):
            points.trace(None, rays)


def test_numbers_of_a_camera_are_one_or_one_of_each(camera: Camera) -> None:
    batch = Camera.stack([camera, camera])
    with pytest.raises(InputError, match=r"fx as a number or one of each camera, .* shape \(3,\)"):
        replace(batch, fx=torch.ones(3))
    with pytest.raises(InputError, match=r"cy as a number, got a tensor of shape \(2,\)"):
        replace(camera, cy=torch.ones(2))

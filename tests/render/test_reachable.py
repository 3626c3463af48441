"""Pixels that can show a point: never too few of them."""

import pytest
import torch

from pcore.deform.pose import pose
from pcore.deform.simple import rigid
from pcore.editing.script import parse_edit
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.render.reachable import reachable

CUTOFF = 0.12
EDITS = {
    "rest": None,
    "twist": {"type": "twist", "axis": "z", "angle_deg": 90},
    "stretch": {"type": "stretch", "axis": "x", "factor": 1.5, "profile": "axial"},
}


def posed_as(name: str) -> PosedCloud:
    positions = torch.randn(60, 3, generator=torch.Generator().manual_seed(4))
    cloud = PointCloud(positions=positions, features=torch.zeros(60, 2), influence=torch.zeros(60))
    edit = EDITS[name]
    if edit is None:
        return PosedCloud.at_rest(cloud)
    return pose(cloud, parse_edit({"version": 2, "edits": [edit]}).bind(positions))


def cameras(posed: PosedCloud) -> list[Camera]:
    """One before it and one among it, which looks at half of it from nearby."""
    far = orbit_around(posed.positions, size=(60, 40))[0]
    near = far.moved(far.world_from_camera.clone())
    near.world_from_camera[:3, 3] *= 0.5
    return [far, near]


@pytest.mark.parametrize("name", EDITS)
def test_every_ray_that_meets_a_point_is_sent(name: str):
    posed = posed_as(name)
    stretch = 1.0 if posed.local_maps is None else posed.local_maps.stretch
    for camera in cameras(posed):
        corners = torch.tensor([[0.0, 0.0], [0.5, 0.5], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
        lines = camera.rays(places=corners).flat()
        across = _across(lines, posed)
        met = (across <= CUTOFF * stretch).any(dim=1).reshape(40, 60, 5).any(dim=2)
        shown = reachable(posed, camera, CUTOFF)
        assert shown is None or bool((shown | ~met).all())
    far = reachable(posed, cameras(posed)[0], CUTOFF)
    assert far is not None
    assert 0.02 < float(far.float().mean()) < 0.9


def _across(lines: RayBundle, posed: PosedCloud) -> torch.Tensor:
    """Distances (R, N) of points from rays."""
    offset = posed.positions - lines.origins.unsqueeze(1)
    along = (offset * lines.directions.unsqueeze(1)).sum(dim=2, keepdim=True)
    return (offset - along * lines.directions.unsqueeze(1)).norm(dim=2)


def test_without_a_limit_all_rays_are_sent_and_beside_a_point_too():
    posed = posed_as("rest")
    camera = cameras(posed)[0]
    assert reachable(posed, camera, None) is None
    inside = camera.moved(camera.world_from_camera.clone())
    inside.world_from_camera[:3, 3] = posed.positions[0]
    assert reachable(posed, inside, CUTOFF) is None
    turned = pose(posed.cloud, rigid("z", 0.5))
    assert reachable(turned, camera, CUTOFF) is not None

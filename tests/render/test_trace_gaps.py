"""Lines that enter an object through a gap are looked at from their other ends."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import tiny_scene
from pcore.deform.pose import pose
from pcore.deform.simple import Twist, uniform_scale
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.hits import Hits
from pcore.model.papr import Papr
from pcore.render.trace import gaps, trace

CUTOFF = 0.2


class SeenFromAbove(torch.nn.Module):
    """Attention that knows points from one side only: opaque for rays that go down."""

    def forward(
        self, posed: PosedCloud, rays: RayBundle, neighbours: Tensor, *_: Any, **__: Any
    ) -> Hits:
        weights = torch.zeros(neighbours.shape)
        weights[:, 0] = 1.0
        down = rays.directions[:, 2] < 0
        return Hits(
            neighbours=neighbours,
            weights=weights,
            background=torch.where(down, 0.1, 0.9),
            features=down[:, None].float().expand(-1, 4),
            centroid=posed.positions[neighbours[:, 0]],
            spread=torch.zeros(len(neighbours)),
        )


def sheet() -> PointCloud:
    """A square of side 1 in the plane z = 0, its points 0.05 apart."""
    steps = torch.linspace(-0.5, 0.5, 21)
    rows, columns = torch.meshgrid(steps, steps, indexing="ij")
    places = torch.stack([columns, rows, torch.zeros_like(rows)], dim=-1).reshape(-1, 3)
    return PointCloud(positions=places, features=torch.zeros(441, 4), influence=torch.ones(441))


def network() -> Papr:
    papr = Papr(replace(tiny_scene.CONFIG, cutoff=CUTOFF)).eval()
    papr.attention = SeenFromAbove()  # pyright: ignore[reportAttributeAccessIssue]
    return papr


def rays(height: float) -> RayBundle:
    """16 x 16 rays through the sheet and past it, from above (3) or from below (-3)."""
    pose = torch.eye(4)
    if height < 0:
        pose[1, 1] = pose[2, 2] = -1.0
    pose[2, 3] = height
    return Camera.from_fov(pose, width=16, height=16, angle_x=0.6).rays().flat()


def twisted(cloud: PointCloud, aware: bool = True) -> PosedCloud:
    """Both ends of the sheet turned by 10 degrees."""
    turn = Twist(
        rotation=torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
        origin=torch.zeros(3),
        extent=(-0.5, 0.5),
        value=math.radians(20),
    )
    return pose(cloud, turn, aware=aware)


@torch.no_grad()
def test_what_is_opaque_from_one_end_is_opaque_from_the_other() -> None:
    papr, posed = network(), twisted(sheet())
    above, below = (trace(papr, posed, rays(height)) for height in (3.0, -3.0))
    solid = [(1 - one.background) > 0.5 for one in (above, below)]
    assert 60 < int(solid[0].sum()) < 256
    # From below rays within a quarter of the cut-off of a point are turned.
    assert int(solid[1].sum()) > 0.6 * int(solid[0].sum())
    ray = rays(-3.0)
    offset = posed.positions[below.neighbours[solid[1], 0]] - ray.origins[solid[1]]
    assert float(torch.linalg.cross(offset, ray.directions[solid[1]]).norm(dim=-1).max()) < 0.05
    places = posed.positions[below.neighbours[solid[1], 0]]
    assert torch.equal(below.centroid[solid[1]], places)
    assert (below.features[solid[1]] == 1).all()


@torch.no_grad()
def test_nothing_is_turned_where_nothing_came_apart() -> None:
    papr, cloud = network(), sheet()
    grown = pose(cloud, uniform_scale(1.1))
    for still in (PosedCloud.at_rest(cloud), grown, twisted(cloud, aware=False)):
        assert float(trace(papr, still, rays(-3.0)).background.min()) == pytest.approx(0.9)


@torch.no_grad()
def test_rays_that_pass_by_or_begin_among_the_points_are_left_alone() -> None:
    posed = PosedCloud.at_rest(sheet())
    along = torch.tensor([[0.0, 0.0, 1.0]]).expand(4, 3)
    origins = torch.tensor([[0.01, 0.0, -3.0], [0.56, 0.0, -3.0], [0.01, 0.0, -0.3], [9.0, 0, -3]])
    lines = RayBundle(origins=origins, directions=along)
    weights = torch.tensor([[1.0], [1.0], [1.0], [0.0]])
    neighbours = (posed.positions[:, :2] - origins[:, None, :2]).norm(dim=-1).argmin(dim=1)
    hits = Hits(
        neighbours=neighbours[:, None],
        weights=weights,
        background=torch.full((4,), 0.8),
        features=torch.zeros(4, 4),
        centroid=torch.zeros(4, 3),
        spread=torch.zeros(4),
    )
    assert gaps(hits, posed, lines, CUTOFF).tolist() == [0]
    dense = replace(hits, background=torch.full((4,), 0.4))
    assert len(gaps(dense, posed, lines, CUTOFF)) == 0


def test_a_turned_line_begins_behind_all_points() -> None:
    posed, lines = PosedCloud.at_rest(sheet()), rays(-3.0)
    back = lines.from_other_ends(*posed.sphere)
    torch.testing.assert_close(back.directions, -lines.directions)
    apart = torch.linalg.cross(back.origins - lines.origins, lines.directions).norm(dim=-1)
    assert float(apart.max()) < 1e-4
    depth = ((posed.positions[None] - back.origins[:, None]) * back.directions[:, None]).sum(dim=-1)
    assert float(depth.min()) > 0

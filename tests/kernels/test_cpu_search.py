"""The search on the CPU drops points for whole bundles of rays: its result must be that of brute
force in the same arithmetic, bit for bit, for bundles of every kind."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.kernels import cpu_search

Rays = tuple[Tensor, Tensor]


def brute_force(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Squared distances in float32 and in one order of operations; equals in order of the index."""
    p = points.numpy().T
    found: list[np.ndarray] = []
    with np.errstate(all="ignore"):
        for o, d in zip(origins.numpy(), directions.numpy(), strict=True):
            v = [p[i] - o[i] for i in range(3)]
            along = v[0] * d[0] + v[1] * d[1] + v[2] * d[2]
            t = [v[i] - along * d[i] for i in range(3)]
            squared = t[0] * t[0] + t[1] * t[1] + t[2] * t[2]
            found.append(np.argsort(squared, kind="stable")[:k])
    return torch.from_numpy(np.stack(found))


def unit(x: Tensor) -> Tensor:
    return torch.nn.functional.normalize(x, dim=-1)


def shell(count: int) -> Tensor:
    """A bumpy surface: what learned points look like."""
    d = unit(torch.randn(count, 3))
    radius = 0.6 + 0.2 * torch.sin(5 * d[:, :1]) * torch.cos(4 * d[:, 1:2])
    return d * radius + 0.002 * torch.randn(count, 3)


def image(distance: float = 4.0, size: int = 34, fov: float = 0.7) -> Rays:
    pose = torch.eye(4)
    pose[:3, :3] = torch.linalg.qr(torch.randn(3, 3)).Q
    pose[:3, 0] *= torch.linalg.det(pose[:3, :3]).sign()
    pose[:3, 3] = distance * pose[:3, 2]
    camera = Camera.from_fov(pose, width=size, height=size - 3, angle_x=fov)
    rays = camera.rays().flat()
    return rays.origins.contiguous(), rays.directions


def near_surface() -> Rays:
    """Every ray has an origin of its own, as after a deformation of points and rays."""
    origins, directions = image()
    ends = origins + 3.4 * directions
    starts = ends - 0.3 * directions
    ends, starts = (
        torch.stack([x[:, 0] + 0.3 * x[:, 2].sin(), x[:, 1], x[:, 2] * 1.4], dim=-1)
        for x in (ends, starts)
    )
    return starts, unit(ends - starts)


def incoherent() -> Rays:
    return torch.randn(300, 3), unit(torch.randn(300, 3))


def opposite() -> Rays:
    origins, directions = image()
    return origins, directions * torch.where(torch.rand(len(origins), 1) < 0.5, -1.0, 1.0)


def crossing() -> Rays:
    """Directions that agree, through a plane where the lines spread, beside lines at an angle."""
    origins, directions = image()
    some = torch.rand(len(origins), 1) < 0.1
    return origins, torch.where(some, unit(directions + 0.7 * torch.randn(3)), directions)


def parallel() -> Rays:
    start = torch.cat([torch.rand(500, 2) * 2 - 1, torch.zeros(500, 1)], dim=-1)
    return start, torch.tensor([0.0, 0.0, 1.0]).expand(500, 3).contiguous()


def equal_lines() -> Rays:
    return torch.ones(100, 3), unit(torch.ones(100, 3))


def not_quite_unit() -> Rays:
    origins, directions = image()
    return origins, directions * (1 + 1e-3 * torch.randn(len(origins), 1))


BUNDLES: dict[str, Callable[[], Rays]] = {
    "image": image,
    "inside": lambda: image(distance=0.1, fov=1.5),
    "wide": lambda: image(fov=2.6),
    "far": lambda: image(distance=300.0, fov=0.01),
    "near_surface": near_surface,
    "incoherent": incoherent,
    "opposite": opposite,
    "crossing": crossing,
    "parallel": parallel,
    "equal_lines": equal_lines,
    "not_quite_unit": not_quite_unit,
}


@pytest.mark.parametrize("k", [1, 20, 64])
@pytest.mark.parametrize("name", BUNDLES)
def test_equals_brute_force_bit_for_bit(name: str, k: int) -> None:
    origins, directions = BUNDLES[name]()
    points = shell(3001)
    found = cpu_search.nearest_to_rays(origins, directions, points, k)
    assert torch.equal(found, brute_force(origins, directions, points, k))


def grid(count: int) -> Tensor:
    """Many equal distances, and many equal points."""
    return torch.randint(-3, 4, (count, 3)).float() * 0.25


def plane(count: int) -> Tensor:
    return torch.randn(count, 3) * torch.tensor([1.0, 1.0, 0.0])


def needle(count: int) -> Tensor:
    return torch.randn(count, 3) * torch.tensor([1.0, 1e-4, 1e-4])


def far_from_the_world_origin(count: int) -> Tensor:
    return shell(count) + torch.tensor([500.0, -300.0, 200.0])


def outlier(count: int) -> Tensor:
    points = shell(count)
    points[count // 2] = torch.tensor([1e6, 0.0, 0.0])
    return points


@pytest.mark.parametrize("cloud", [grid, plane, needle, far_from_the_world_origin, outlier])
@pytest.mark.parametrize("bundle", ["image", "inside", "near_surface"])
def test_clouds_of_every_kind(cloud: Callable[[int], Tensor], bundle: str) -> None:
    origins, directions = BUNDLES[bundle]()
    points = cloud(1000)
    if cloud is far_from_the_world_origin:
        origins = origins + points.mean(dim=0)
    found = cpu_search.nearest_to_rays(origins, directions, points, 20)
    assert torch.equal(found, brute_force(origins, directions, points, 20))


def one_line_and_points_at(heights: Tensor, along: Tensor) -> tuple[Rays, Tensor]:
    """Twelve times the same line, and points at these distances from it and along it."""
    direction, across = unit(torch.randn(2, 3)).double()
    across = unit(across - (across @ direction) * direction)
    other = torch.linalg.cross(direction, across)
    angle = 2 * math.pi * torch.rand(len(heights), dtype=torch.float64)
    around = angle.cos().unsqueeze(1) * across + angle.sin().unsqueeze(1) * other
    points = heights.double().unsqueeze(1) * around + along.double().unsqueeze(1) * direction
    origin = -1000.0 * direction
    lines = (
        origin.float().expand(12, 3).contiguous(),
        direction.float().expand(12, 3).contiguous(),
    )
    return lines, points.float()


def test_points_that_rounding_brings_nearer_are_not_dropped() -> None:
    """The bounds are those of exact distances; the specification's are wrong by 1e-4 here."""
    (origins, directions), points = one_line_and_points_at(
        0.1 + 1e-4 * torch.rand(400), torch.rand(400) - 0.5
    )
    found = cpu_search.nearest_to_rays(origins, directions, points, 20)
    assert torch.equal(found, brute_force(origins, directions, points, 20))


def test_points_that_a_direction_too_long_brings_nearer_are_not_dropped() -> None:
    """|v - <v, d> d| grows along a line whose d is too long: far along it, near is far."""
    near_line = torch.arange(400) % 2 == 0
    (origins, directions), points = one_line_and_points_at(
        torch.where(near_line, 0.01, 0.3), torch.where(near_line, 900.0, 0.0) + torch.rand(400)
    )
    origins = origins + 1000 * directions
    directions = directions * 1.001
    found = cpu_search.nearest_to_rays(origins, directions, points, 20)
    assert bool((~near_line)[found].all())
    assert torch.equal(found, brute_force(origins, directions, points, 20))


@pytest.mark.parametrize("number", [math.nan, -math.nan, math.inf, 1e30])
def test_points_that_are_no_numbers_come_last(number: float) -> None:
    origins, directions = image()
    points = shell(500)
    points[::7] = number
    found = cpu_search.nearest_to_rays(origins, directions, points, 20)
    clean = torch.nonzero(torch.arange(500) % 7).squeeze(-1)
    expected = clean[brute_force(origins, directions, points[clean], 20)]
    assert torch.equal(found, expected)


def test_rays_that_are_no_numbers_leave_the_others_alone() -> None:
    origins, directions = image()
    points = shell(500)
    expected = brute_force(origins, directions, points, 8)
    directions[5], origins[40] = math.nan, math.inf
    found = cpu_search.nearest_to_rays(origins, directions, points, 8)
    rest = torch.ones(len(origins), dtype=torch.bool)
    rest[[5, 40]] = False
    assert torch.equal(found[rest], expected[rest])
    assert 0 <= int(found.min()) <= int(found.max()) < 500


def test_the_order_of_rays_does_not_matter() -> None:
    origins, directions = near_surface()
    points, mixed = shell(2000), torch.randperm(len(origins))
    expected = cpu_search.nearest_to_rays(origins, directions, points, 12)
    found = cpu_search.nearest_to_rays(origins[mixed], directions[mixed], points, 12)
    assert torch.equal(found, expected[mixed])


@pytest.mark.parametrize("workers", [2, 3])
def test_parts_for_several_workers_give_the_same(workers: int) -> None:
    """Workers share out parts whatever the number of threads behind them."""
    (origins, directions), points = near_surface(), shell(2000)
    columns = np.ascontiguousarray(points.numpy().T)
    found = cpu_search.search(origins.numpy(), directions.numpy(), columns, 12, workers)
    assert torch.equal(torch.from_numpy(found), brute_force(origins, directions, points, 12))

"""A ray meets the surface over points, and takes its light: edges are sharper than points."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.geometry.rays import RayBundle
from pcore.geometry.surfels import Surfels
from pcore.render.surface import gains_at, intersect, meet_planes

STEP = 0.1
INSIDE = 0.05
"""How deep below the surface points lie."""


def surfels_of(points: Tensor, normals: Tensor, lift: float = INSIDE) -> Surfels:
    heights = torch.full((len(points),), lift)
    return replace(Surfels.at_rest(points, normals, heights), spacing=STEP)


def gains_of_rays(
    surfels: Surfels, gains: Tensor, rays: RayBundle, weights: Tensor, near: Tensor
) -> Tensor:
    return gains_at(surfels, gains, rays, *meet_planes(surfels, rays, weights, near))


def roof() -> tuple[Tensor, Surfels, Tensor]:
    """Two slopes that meet along y at x = z = 0, the left one dark and the right one bright.

    No point is nearer to the ridge than half a step.
    """
    down = STEP * (torch.arange(12) + 0.5)
    along = STEP * torch.arange(-6, 7)
    flat = torch.cartesian_prod(down, along)
    half = math.sqrt(0.5)
    sides, normals = [], []
    for sign in (-1.0, 1.0):
        normal = torch.tensor([sign * half, 0.0, half])
        slope = torch.tensor([sign * half, 0.0, -half])
        surface = flat[:, :1] * slope + flat[:, 1:] * torch.tensor([0.0, 1.0, 0.0])
        sides.append(surface - INSIDE * normal)
        normals.append(normal.expand(len(flat), 3))
    gains = torch.tensor([0.5, 2.0]).repeat_interleave(len(flat))
    points = torch.cat(sides)
    return points, surfels_of(points, torch.cat(normals)), gains


def rays_to(targets: Tensor, origin: tuple[float, float, float]) -> RayBundle:
    start = torch.tensor(origin).expand_as(targets)
    return RayBundle(origins=start, directions=F.normalize(targets - start, dim=1))


def seen(points: Tensor, rays: RayBundle, k: int = 8) -> tuple[Tensor, Tensor]:
    """The k points nearest to each ray, all of one weight: attention that knows no edge."""
    offset = points - rays.origins[:, None]
    along = (offset * rays.directions[:, None]).sum(dim=2, keepdim=True)
    across = (offset - along * rays.directions[:, None]).norm(dim=2)
    return torch.full((len(rays.origins), k), 1 / k), across.argsort(dim=1)[:, :k]


def on_the_roof(x: Tensor) -> Tensor:
    return torch.stack([x, torch.full_like(x, 0.013), -x.abs()], dim=1)


def test_light_changes_at_an_edge_and_not_beside_it() -> None:
    points, surface, gains = roof()
    x = torch.tensor([-0.3, -0.15, -0.05, 0.05, 0.15, 0.3])
    rays = rays_to(on_the_roof(x), (0.0, 0.0, 3.0))
    weights, near = seen(points, rays)
    found = gains_of_rays(surface, gains, rays, weights, near).log2()
    by_points = (weights * gains.log2()[near]).sum(dim=1)
    # Half a step beside the ridge the points are those of both slopes, the pieces around one's.
    assert by_points[2:4].abs().max() < 0.51
    assert found[0] < -0.99 < 0.99 < found[5]
    assert found[1] < -0.95 < 0.95 < found[4]
    assert found[2] < -0.65 < 0.65 < found[3]


def test_what_faces_away_has_no_say() -> None:
    """From the right, near the ridge, only the right slope is seen."""
    points, surface, gains = roof()
    x = torch.tensor([0.01, 0.05, 0.2])
    rays = rays_to(on_the_roof(x), (3.0, 0.0, 0.0))
    found = gains_of_rays(surface, gains, rays, *seen(points, rays))
    torch.testing.assert_close(found, torch.full((3,), 2.0), rtol=1e-3, atol=0)


def sheet() -> tuple[Tensor, Surfels, Tensor]:
    """A thin sheet whose upper side got brighter and whose lower side darker."""
    grid = STEP * torch.cartesian_prod(torch.arange(-6.0, 7), torch.arange(-6.0, 7))
    upper = torch.cat([grid, torch.full((len(grid), 1), 0.01)], dim=1)
    points = torch.cat([upper, upper * torch.tensor([1.0, 1.0, -1.0])])
    normals = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]).repeat_interleave(len(grid), dim=0)
    gains = torch.tensor([1.5, 0.5]).repeat_interleave(len(grid))
    return points, surfels_of(points, normals), gains


@pytest.mark.parametrize(("height", "expected"), [(2.0, 1.5), (-2.0, 0.5)])
def test_each_side_of_a_sheet_has_its_own_light(height: float, expected: float) -> None:
    points, surface, gains = sheet()
    targets = torch.tensor([[0.03, 0.02, 0.0], [0.25, -0.11, 0.0]])
    rays = rays_to(targets, (0.4, 0.3, height))
    found = gains_of_rays(surface, gains, rays, *seen(points, rays))
    torch.testing.assert_close(found, torch.full((2,), expected), rtol=1e-4, atol=0)


def test_where_all_faces_away_those_beside_tell() -> None:
    """The inside of a shell through an open rim: no piece faces the ray, none is left out."""
    points, surface, gains = sheet()
    lower = len(points) // 2
    only = surfels_of(points[:lower], surface.normals[:lower])
    rays = rays_to(torch.tensor([[0.03, 0.02, 0.0]]), (0.4, 0.3, -2.0))
    weights, near = seen(points[:lower], rays)
    found = gains_of_rays(only, gains[:lower], rays, weights, near)
    torch.testing.assert_close(found, torch.tensor([1.5]), rtol=1e-5, atol=0)
    # All lie at one height, and the ray meets the mean of them there, not their planes' places.
    depth = ((only.places[near] - rays.origins[:, None]) * rays.directions[:, None]).sum(dim=2)
    place, _ = meet_planes(only, rays, weights, near)
    along = float((place - rays.origins).norm())
    assert float(depth.min()) - 1e-5 < along < float(depth.max()) + 1e-5
    assert along > float(((only.places[0, 2] + 2.0) / rays.directions[0, 2]).abs()) - 0.5


def test_word_for_word() -> None:
    """Plane by plane and piece by piece, on a cloud that faces in every direction."""
    draw = torch.Generator().manual_seed(1)
    points = torch.rand(80, 3, generator=draw)
    normals = F.normalize(torch.randn(80, 3, generator=draw), dim=1)
    normals[::7] = 0
    surface, gains = surfels_of(points, normals), torch.rand(80, generator=draw) + 0.5
    rays = rays_to(torch.rand(40, 3, generator=draw), (0.5, 0.5, 4.0))
    _, near = seen(points, rays)
    weights = torch.rand(40, 8, generator=draw)
    weights = weights / weights.sum(dim=1, keepdim=True)
    found = gains_of_rays(surface, gains, rays, weights, near)
    for row, (start, ahead) in enumerate(zip(rays.origins, rays.directions, strict=True)):
        told: list[tuple[float, float, int]] = []  # weight, distance, index
        for weight, index in zip(weights[row].tolist(), near[row].tolist(), strict=True):
            offset, normal = surface.places[index] - start, surface.normals[index]
            cosine, depth = float(normal @ ahead), float(offset @ ahead)
            if cosine < -0.05:
                plane = float(offset @ normal) / min(cosine, -0.2)
                plane = min(max(plane, depth - 2 * STEP), depth + 2 * STEP)
                apart = float((plane * ahead - offset).square().sum()) / STEP**2
                told.append((weight / (1 + apart) ** 2, plane, index))
        assert told, "of eight random directions none faces the camera"
        share = sum(weight for weight, _, _ in told)
        place = start + sum(weight * plane for weight, plane, _ in told) / share * ahead
        middle = max(told)[2]
        total, mean = 0.0, 0.0
        for index in surface.beside[middle].tolist():
            apart = float((surface.places[index] - place).square().sum()) / (0.6 * STEP) ** 2
            counts = 1.0 if float(surface.normals[index] @ ahead) < -0.05 else 1e-6
            counts /= (1 + apart) ** 2
            total += counts
            mean += counts * math.log(2) * float(gains.log2()[index])
        assert float(found[row]) == pytest.approx(math.exp(mean / total), rel=1e-4), row


def test_the_same_everywhere_is_the_same() -> None:
    points, surface, gains = roof()
    rays = rays_to(on_the_roof(torch.linspace(-0.5, 0.5, 40)), (0.3, 0.1, 3.0))
    weights, near = seen(points, rays)
    ones = torch.ones(len(gains))
    assert torch.equal(gains_of_rays(surface, ones, rays, weights, near), torch.ones(40))


def test_the_surface_is_as_deep_as_the_planes_and_not_as_the_points() -> None:
    """Slanting views too, where a mean of points is off by much more than they are too deep."""
    points, surface, _ = roof()
    for eye, x in (((0.0, 0.0, 3.0), [-0.4, -0.25, 0.2, 0.3]), ((0.6, 1.5, 1.0), [0.25, 0.4])):
        targets = on_the_roof(torch.tensor(x))
        rays = rays_to(targets, eye)
        weights, near = seen(points, rays)
        places, middle = meet_planes(surface, rays, weights, near)
        torch.testing.assert_close(places, targets, rtol=0, atol=0.005)
        mean = (weights.unsqueeze(-1) * points[near]).sum(dim=1)
        depth = ((mean - rays.origins) * rays.directions).sum(dim=1)
        expected = (targets - rays.origins).norm(dim=1)
        assert float((depth - expected).mean()) > 0.04
        assert bool(((points[middle] - targets).norm(dim=1) < 0.2).all())


def test_a_surface_that_nobody_knows_is_as_bright_as_before() -> None:
    points, surface, gains = roof()
    rays = rays_to(on_the_roof(torch.tensor([0.3, 0.4])), (0.0, 0.0, 3.0))
    weights, near = seen(points, rays)
    assert float(gains_of_rays(surface, gains, rays, weights, near).min()) > 1.9
    blind = replace(surface, beside=surface.beside[:, :0])
    assert torch.equal(gains_of_rays(blind, gains, rays, weights, near), torch.ones(2))
    assert intersect(surface, None, rays, weights, near)[1] is None


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_units_do_not_matter(scale: float) -> None:
    points, surface, gains = roof()
    rays = rays_to(on_the_roof(torch.linspace(-0.2, 0.2, 9)), (0.3, 0.1, 3.0))
    weights, near = seen(points, rays)
    expected = gains_of_rays(surface, gains, rays, weights, near)
    larger = replace(surface, places=scale * surface.places, spacing=scale * surface.spacing)
    moved = RayBundle(origins=scale * rays.origins, directions=rays.directions)
    found = gains_of_rays(larger, gains, moved, weights, near)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=0)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("lit", [True, False])
def test_the_kernel_of_the_cpu_says_the_same(
    lit: bool, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a cloud that faces in every direction, seen from everywhere."""
    draw = torch.Generator().manual_seed(8)
    points = torch.rand(300, 3, generator=draw)
    normals = F.normalize(torch.randn(300, 3, generator=draw), dim=1)
    normals[::5] = 0
    surfels = surfels_of(points, normals)
    surfels = surfels if known else replace(surfels, beside=surfels.beside[:, :0])
    lights = torch.rand(300, generator=draw) + 0.5 if lit else None
    ends = torch.rand(500, 3, generator=draw)
    starts = 0.5 + 4 * F.normalize(torch.randn(500, 3, generator=draw), dim=1)
    rays = RayBundle(origins=starts, directions=F.normalize(ends - starts, dim=1))
    _, near = seen(points, rays)
    weights = torch.rand(500, 8, generator=draw).pow(4)
    weights[:, 5:] = 0
    places, gains = intersect(surfels, lights, rays, weights, near)
    monkeypatch.setenv("PCORE_KERNELS", "reference")
    expected, factors = intersect(surfels, lights, rays, weights, near)
    torch.testing.assert_close(places, expected, rtol=0, atol=1e-5)
    if lit:
        assert gains is not None
        assert factors is not None
        torch.testing.assert_close(gains, factors, rtol=1e-4, atol=0)
        assert bool((gains == 1).all()) is not known
    else:
        assert gains is factors is None
    wide = intersect(
        surfels.each(lambda one: one.double() if one.is_floating_point() else one),
        None if lights is None else lights.double(),
        RayBundle(origins=rays.origins.double(), directions=rays.directions.double()),
        weights.double(),
        near,
    )[0]
    assert wide.dtype == torch.float64
    torch.testing.assert_close(wide.float(), expected, rtol=0, atol=1e-5)


def test_a_point_alone() -> None:
    one = Surfels(
        places=torch.zeros(1, 3),
        normals=torch.tensor([[0.0, 0.0, 1.0]]),
        heights=torch.zeros(1),
        beside=torch.zeros(1, 1, dtype=torch.int64),
        spacing=0.0,
    )
    for target in (torch.zeros(1, 3), torch.tensor([[0.1, 0.0, 0.0]])):
        rays = rays_to(target, (0.0, 0.0, 3.0))
        gains = torch.tensor([1.25])
        found = gains_of_rays(
            one, gains, rays, torch.ones(1, 1), torch.zeros(1, 1, dtype=torch.int64)
        )
        torch.testing.assert_close(found, torch.tensor([1.25]))
        one_weight, one_point = torch.ones(1, 1), torch.zeros(1, 1, dtype=torch.int64)
        place, gain = intersect(one, gains, rays, one_weight, one_point)
        assert gain is not None
        torch.testing.assert_close(gain, torch.tensor([1.25]))
        torch.testing.assert_close(place, meet_planes(one, rays, one_weight, one_point)[0])

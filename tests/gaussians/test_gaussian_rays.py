"""What single rays see of Gaussians: closed forms, pictures, maps of space, gradients."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from some import some_gaussians
from torch import Tensor
from torch.nn.functional import normalize

from pcore.deform.base import Affine
from pcore.gaussians.gaussian_rays import Traced, trace
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, pose, render
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.rays import RayBundle

WHITE = torch.ones(3)


def balls(depths: list[float], opacities: list[float], colors: list[list[float]]) -> Gaussians:
    """Round Gaussians along x, a tenth of a unit large."""
    count = len(depths)
    return Gaussians(
        means=torch.tensor([[depth, 0.0, 0.0] for depth in depths]),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(count, 4),
        scales=torch.full((count, 3), 0.1),
        opacities=torch.tensor(opacities),
        sh=((torch.tensor(colors) - 0.5) / 0.28209479177387814).unsqueeze(1),
    )


def along_x(offsets: list[float]) -> RayBundle:
    count = len(offsets)
    return RayBundle(
        origins=torch.tensor([[0.0, offset, 0.0] for offset in offsets]),
        directions=torch.tensor([[1.0, 0.0, 0.0]]).expand(count, 3),
    )


def lines(gaussians: Gaussians, rays: RayBundle) -> Traced:
    return trace(PosedGaussians(gaussians=gaussians), rays, background=WHITE, footprint=Footprint())


def test_one_gaussian_is_its_density_where_the_ray_passes_nearest() -> None:
    found = lines(balls([3.0], [0.8], [[1.0, 0.0, 0.0]]), along_x([0.0, 0.1, 0.15, 5.0]))
    alpha = 0.8 * torch.exp(-0.5 * torch.tensor([0.0, 1.0, 1.5]).square())
    torch.testing.assert_close(found.alpha[:3], alpha)
    torch.testing.assert_close(found.depth[:3], torch.full((3,), 3.0))
    assert found.alpha[3] == 0
    assert found.depth[3] == 0
    torch.testing.assert_close(found.rgb[3], WHITE)
    expected = alpha[1] * torch.tensor([1.0, 0.0, 0.0]) + (1 - alpha[1]) * WHITE
    torch.testing.assert_close(found.rgb[1], expected)


def test_rays_that_meet_nothing_see_what_is_behind() -> None:
    found = lines(balls([3.0], [0.8], [[1.0, 0.0, 0.0]]), along_x([5.0, -4.0]))
    assert torch.equal(found.rgb, torch.ones(2, 3))
    assert torch.equal(found.alpha, torch.zeros(2))


def test_blending_is_front_to_back_whatever_the_order_of_rows() -> None:
    gaussians = balls([5.0, 3.0], [0.5, 0.6], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    for one in (gaussians, gaussians.each(lambda tensor: tensor.flip(0))):
        found = lines(one, along_x([0.0]))
        torch.testing.assert_close(found.rgb[0], torch.tensor([0.8, 0.4, 0.2]))
        alpha = 0.6 + 0.4 * 0.5
        depth = (0.6 * 3 + 0.2 * 5) / alpha
        torch.testing.assert_close(found.depth[0], torch.tensor(depth))
        spread = 0.6 * (3 - depth) ** 2 + 0.2 * (5 - depth) ** 2
        torch.testing.assert_close(found.spread[0], torch.tensor(spread))


def test_what_lies_behind_the_origin_is_not_seen() -> None:
    gaussians = balls([-2.0, 3.0], [0.9, 0.6], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    torch.testing.assert_close(lines(gaussians, along_x([0.0])).alpha, torch.tensor([0.6]))


@pytest.mark.parametrize(
    ("footprint", "most"),
    [
        (Footprint(), 0.02),
        (Footprint(flat=True), 0.02),
        # Sharp: a disc that stands across the view shows where perspective ends.
        (Footprint(flat=True, antialiased=False, variance=0.5), 0.05),
    ],
)
def test_rays_as_wide_as_pixels_see_what_the_camera_sees(footprint: Footprint, most: float) -> None:
    (camera,) = orbit_cameras(
        torch.zeros(3), 6.0, 1, elevation=0.3, width=24, height=20, angle_x=0.1
    )
    # A camera from far away orders Gaussians as its rays do.
    gaussians = some_gaussians(60)
    gaussians = replace(gaussians, means=0.4 * gaussians.means, scales=0.5 * gaussians.scales)
    posed = PosedGaussians(gaussians=gaussians)
    if footprint.flat:
        thin = gaussians.scales * torch.tensor([1.0, 1.0, 0.0]) + 1e-7
        posed = PosedGaussians(gaussians=replace(gaussians, scales=thin))
    picture = render(posed, [camera], footprint=footprint)
    rays = camera.rays().flat()
    widths = (6.0 / camera.fx) ** 2 * torch.eye(3).expand(24 * 20, 3, 3)
    found = trace(posed, rays, background=WHITE, footprint=footprint, pixels=widths)
    apart = (found.rgb - picture.rgb[0].reshape(-1, 3)).abs()
    # A camera projects towards its centre, a ray along itself.
    assert float(apart.amax()) < most
    assert float(apart.mean()) < 4e-3
    assert float((found.alpha - picture.alpha[0].reshape(-1)).abs().mean()) < 4e-3


def rays_at(points: Tensor, eye: Tensor) -> RayBundle:
    return RayBundle(origins=eye.expand_as(points), directions=normalize(points - eye, dim=-1))


def test_carried_gaussians_look_from_carried_rays_as_before() -> None:
    """One affine map of everything changes nothing: what P-CORE's losses see is the rest."""
    draw = torch.Generator().manual_seed(4)
    matrix = torch.eye(3) + 0.4 * torch.randn(3, 3, generator=draw)
    field = Affine(matrix.double(), torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    # Far apart in depth, since an affine map may order neighbours side by side another way.
    gaussians = balls(
        [2.0, 4.0, 7.0], [0.5, 0.6, 0.7], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0] * 3]
    )
    targets = torch.tensor([[4.0, 0.05, 0.1], [4.0, -0.1, 0.02]])
    eye, widths = torch.tensor([0.0, 0.01, 0.0]), 0.05**2 * torch.eye(3).expand(2, 3, 3)
    rest = trace(
        PosedGaussians(gaussians=gaussians),
        rays_at(targets, eye),
        background=WHITE,
        footprint=Footprint(),
        pixels=widths,
    )
    moved = trace(
        pose(gaussians, field(gaussians.means), matrix.expand(3, 3, 3)),
        rays_at(field(targets), field(eye)),
        background=WHITE,
        footprint=Footprint(),
        pixels=matrix @ widths @ matrix.mT,
    )
    torch.testing.assert_close(moved.rgb, rest.rgb, atol=2e-5, rtol=0)
    torch.testing.assert_close(moved.alpha, rest.alpha, atol=2e-5, rtol=0)


def test_gradients_are_those_of_differences() -> None:
    gaussians = some_gaussians(12, degree=1, dtype=torch.float64)
    gaussians = replace(
        gaussians, means=0.5 * gaussians.means, opacities=0.3 + 0.5 * gaussians.opacities
    )
    eye = torch.tensor([3.0, 0.2, 0.1], dtype=torch.float64)
    rays = rays_at(gaussians.means[:4] + 0.02, eye)
    widths = 0.02**2 * torch.eye(3, dtype=torch.float64).expand(4, 3, 3)

    def seen(means: Tensor, scales: Tensor, opacities: Tensor, sh: Tensor) -> Tensor:
        posed = replace(gaussians, means=means, scales=scales, opacities=opacities, sh=sh)
        found = trace(
            PosedGaussians(gaussians=posed),
            rays,
            background=WHITE,
            footprint=Footprint(),
            pixels=widths,
        )
        return found.rgb.square().sum() + found.depth.sum() + found.spread.sum()

    inputs = [
        tensor.clone().requires_grad_(True)
        for tensor in (gaussians.means, gaussians.scales, gaussians.opacities, gaussians.sh)
    ]
    seen(*inputs).backward()
    draw = torch.Generator().manual_seed(1)
    for index, tensor in enumerate(inputs):
        way = torch.randn(tensor.shape, generator=draw, dtype=torch.float64)
        ends = [
            seen(
                *[
                    one.detach() + (sign * 1e-6 * way if k == index else 0)
                    for k, one in enumerate(inputs)
                ]
            )
            for sign in (1, -1)
        ]
        slope = float(ends[0] - ends[1]) / 2e-6
        assert tensor.grad is not None
        assert math.isclose(float((tensor.grad * way).sum()), slope, rel_tol=1e-4, abs_tol=1e-6)


def test_the_unit_of_the_world_does_not_matter() -> None:
    gaussians = some_gaussians(40, degree=0)
    rays = rays_at(gaussians.means[:8], torch.tensor([3.0, 0.0, 0.0]))
    found = lines(gaussians, rays)
    small = replace(gaussians, means=1e-4 * gaussians.means, scales=1e-4 * gaussians.scales)
    again = lines(small, replace(rays, origins=1e-4 * rays.origins))
    torch.testing.assert_close(again.rgb, found.rgb, atol=1e-4, rtol=0)
    torch.testing.assert_close(1e4 * again.depth, found.depth, atol=1e-3, rtol=0)

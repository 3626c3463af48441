"""What photos say about Gaussians: a ball of flat ones and pictures of it."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.gaussians.covariance import quaternions
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, blended, render
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.surfels import known_normals
from pcore.relight.lamps import sphere
from pcore.render.gaussian_surfels import observe_gaussians, shortest_axes
from small_training import FakeView

COUNT = 400
"""On the ball; one more is inside, one is haze, one is round."""
SIDES = torch.tensor([0.08, 0.08, 0.008])
_FIRST = 0.28209479177387814
"""Of the harmonics: the constant one."""


def upright(normals: Tensor) -> Tensor:
    """Quaternions (N, 4) whose third axis is a normal (N, 3), turned inwards for every other."""
    side = F.normalize(torch.linalg.cross(normals, torch.tensor([[0.3, 0.5, 0.8]])), dim=1)
    axes = torch.stack([side, torch.linalg.cross(normals, side), normals], dim=2)
    axes[::2, :, 1:] *= -1
    return quaternions(axes)


def a_ball() -> Gaussians:
    """Radius 0.6; each side has its own colour."""
    normals = sphere(COUNT)
    count = COUNT + 3
    scales = SIDES.repeat(count, 1)
    scales[-1] = 0.05
    means = torch.cat([0.6 * normals, torch.tensor([[0.0, 0, 0], [0, 0, 0.9], [0.6, 0, 0]])])
    opacities = torch.full((count,), 0.95)
    opacities[-2] = 0.02
    every = torch.cat([normals, torch.tensor([[0.0, 0, 1], [0, 0, 1], [1, 0, 0]])])
    colors = 0.5 + 0.3 * every
    return Gaussians(
        means=means,
        quats=upright(every),
        scales=scales,
        opacities=opacities,
        sh=((colors - 0.5) / _FIRST)[:, None],
    )


def photos(gaussians: Gaussians) -> list[View]:
    """From all around, from above and below; the last Gaussians but one are in none of them."""
    cameras = [
        camera
        for elevation, count in ((0.3, 8), (1.3, 4), (-1.3, 4))
        for camera in orbit_cameras(
            torch.zeros(3), 3.0, count, elevation=elevation, width=48, height=48, angle_x=0.6
        )
    ]
    return [photo(gaussians, camera) for camera in cameras]


def photo(gaussians: Gaussians, camera: Camera) -> View:
    found = render(PosedGaussians(gaussians=gaussians), [camera], footprint=Footprint())
    rgba = torch.cat([found.rgb[0], found.alpha[0, ..., None]], dim=-1).clamp(0, 1)
    return cast("View", FakeView(camera, rgba))


def test_blending_is_linear_and_its_gradient_is_the_weights() -> None:
    """The weights of one pixel sum to its opacity, and give its colour."""
    gaussians = a_ball()
    (camera,) = orbit_cameras(
        torch.zeros(3), 3.0, 1, elevation=0.3, width=24, height=24, angle_x=0.6
    )
    values = (0.5 + _FIRST * gaussians.sh[:, 0]).requires_grad_()
    picture, alpha, depth = blended(gaussians, values, camera, footprint=Footprint())
    drawn = render(
        PosedGaussians(gaussians=gaussians),
        [camera],
        footprint=Footprint(),
        background=torch.zeros(3),
    )
    torch.testing.assert_close(picture, drawn.rgb[0], atol=1e-5, rtol=0)
    depths = camera.depth(gaussians.means).unsqueeze(1)
    expected = blended(gaussians, depths, camera, footprint=Footprint())[0][..., 0] / alpha
    torch.testing.assert_close(depth[alpha > 0], expected[alpha > 0], atol=1e-4, rtol=0)
    (weights,) = torch.autograd.grad(picture[12, 12, 0], values)
    assert float(weights[:, 0].sum()) == pytest.approx(float(alpha[12, 12].detach()), abs=1e-5)
    assert float((weights * values.detach()).sum()) == pytest.approx(
        float(picture[12, 12, 0].detach()), abs=1e-5
    )


def test_normals_are_the_shortest_axes_turned_outwards() -> None:
    gaussians = a_ball()
    told = list[tuple[int, int]]()
    found = observe_gaussians(
        gaussians, Footprint(), photos(gaussians), progress=lambda one, of: told.append((one, of))
    )
    assert told[-1] == (16, 16)
    normals, known = found.normals[:COUNT], known_normals(found.normals)
    cosine = (normals * sphere(COUNT)).sum(dim=1)
    assert float(known[:COUNT].float().mean()) > 0.95
    assert float(cosine[known[:COUNT]].min()) > 0.99
    assert not bool(known[COUNT])  # Inside.
    assert not bool(known[COUNT + 1])  # Haze.
    assert not bool(shortest_axes(gaussians)[1][-1])
    # The round one lies on the ball, whose normal pictures show.
    assert float(found.normals[-1, 0]) > 0.9


def test_colors_are_those_of_the_photos() -> None:
    """The ball's paint changes slowly: half a pixel and a neighbour are 0.3 * 0.1 of it."""
    gaussians = a_ball()
    found = observe_gaussians(gaussians, Footprint(), photos(gaussians))
    known = known_normals(found.normals)[:COUNT]
    truth = 0.5 + 0.3 * sphere(COUNT)
    off = (found.colors[:COUNT] - truth).abs().amax(dim=1)[known]
    assert float(off.median()) < 0.03
    assert bool((found.heights == 0).all())

"""Pictures of Gaussians have the right gradients through the one door, or say that they have none.

Against central differences in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from bent_arm import Arm
from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import asset_of
from pcore.errors import EditError
from pcore.gaussians.carry import polar
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.geometry.camera import Camera
from pcore.render.image import Image

STEP = 1e-6
COUNT = 40
PLANES = ("rgb", "alpha", "depth", "surface")


def rod() -> Gaussians:
    draw = torch.Generator().manual_seed(5)

    def random(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    means = random(COUNT, 3) * torch.tensor([2.0, 0.5, 0.5]) - torch.tensor([0.7, 0.25, 0.25])
    return Gaussians(
        means=means,
        quats=random(COUNT, 4) - 0.5,
        scales=0.08 + 0.1 * random(COUNT, 3),
        opacities=0.3 + 0.5 * random(COUNT),
        sh=random(COUNT, 4, 3) - 0.3,
    )


def camera(
    focal: Tensor | float = 16.0, place: Tensor | None = None, turn: Tensor | None = None
) -> Camera:
    pose = torch.eye(4, dtype=torch.float64)
    if turn is not None:
        zero = torch.zeros_like(turn)
        across = torch.stack([zero, turn, zero, -turn, zero, zero, zero, zero, zero])
        rotation = torch.linalg.matrix_exp(across.reshape(3, 3))
        pose = torch.cat([torch.cat([rotation, pose[:3, 3:]], dim=1), pose[3:]]).clone()
    pose[:3, 3] = torch.tensor([0.3, 0.1, 2.6])
    if place is not None:
        pose = torch.cat([pose[:, :3], torch.cat([pose[:3, 3] + place, pose[3:, 3]])[:, None]], 1)
    return Camera(world_from_camera=pose, width=12, height=9, fx=focal, fy=focal, cx=6.0, cy=4.5)


def with_means(asset: Asset, means: Tensor) -> Asset:
    content = asset.content
    assert isinstance(content, GaussianContent)
    return replace(
        asset, content=replace(content, gaussians=replace(content.gaussians, means=means))
    )


def loss_of(asset: Asset, posed: object, seen: Camera) -> Tensor:
    image = asset.render(posed, seen)  # pyright: ignore
    return mixed(image)


def traced(seen: Camera) -> Tensor:
    """A picture by its rays, four of each pixel."""
    places = torch.tensor([[x, y] for x in (0.25, 0.75) for y in (0.25, 0.75)])
    return mixed(ASSET.trace(None, seen.rays(places=places)))


def mixed(image: Image) -> Tensor:
    """A number from all planes, where something is seen; at some pixels nothing is."""
    assert bool(image.depth.isnan().any())
    weights = torch.Generator().manual_seed(1)
    total = image.rgb.new_zeros(())
    for name in PLANES:
        plane = getattr(image, name)
        share = torch.rand(plane.shape, generator=weights, dtype=torch.float64)
        total = total + (plane.nan_to_num(nan=0.0) * share).sum()
    return total


CASES: dict[str, tuple[Tensor, Callable[[Tensor], Tensor]]] = {
    "angle": (
        torch.tensor(1.3, dtype=torch.float64),
        lambda angle: loss_of(ASSET, ASSET.pose(Arm(angle)), camera()),
    ),
    "focal length": (
        torch.tensor(16.0, dtype=torch.float64),
        lambda focal: loss_of(ASSET, None, camera(focal)),
    ),
    "place of the camera": (
        torch.zeros(3, dtype=torch.float64),
        lambda place: loss_of(ASSET, None, camera(place=place)),
    ),
    "turn of the camera": (
        torch.tensor(0.1, dtype=torch.float64),
        lambda turn: loss_of(ASSET, None, camera(turn=turn)),
    ),
    "turn of the camera, by rays": (
        torch.tensor(0.1, dtype=torch.float64),
        lambda turn: traced(camera(turn=turn)),
    ),
    "means, posed": (
        rod().means,
        lambda means: loss_of(
            with_means(ASSET, means),
            with_means(ASSET, means).pose(Arm(torch.tensor(0.9, dtype=torch.float64))),
            camera(),
        ),
    ),
}
ASSET = asset_of(rod())


@pytest.mark.parametrize("name", CASES)
def test_against_differences(name: str) -> None:
    value, loss = CASES[name]
    asked = value.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(loss(asked), asked)
    direction = torch.rand(
        value.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64
    )
    with torch.no_grad():
        ends = [loss(value + sign * STEP * direction) for sign in (1, -1)]
    expected = float(ends[0] - ends[1]) / (2 * STEP)
    assert abs(expected) > 1e-3
    assert float((gradient * direction).sum()) == pytest.approx(expected, rel=1e-5)


def test_a_deformation_that_loses_the_gradient_says_so() -> None:
    class Cut(Arm):
        def __call__(self, points: Tensor) -> Tensor:
            return super().__call__(points.detach())

    asset = with_means(ASSET, rod().means.requires_grad_())
    with pytest.raises(EditError, match="a gradient to the canonical points is asked for"):
        asset.pose(Cut(torch.tensor(0.9, dtype=torch.float64)))


def test_gains_of_a_caller_are_followed() -> None:
    posed = ASSET.pose(Arm(torch.tensor(0.9, dtype=torch.float64)))
    gains = torch.ones(COUNT, dtype=torch.float64, requires_grad=True)
    lit = ASSET.lit(posed, gains)
    kept = ASSET.gains_of(lit)
    assert kept is not None
    assert kept.requires_grad
    (gradient,) = torch.autograd.grad(ASSET.render(lit, camera()).rgb.sum(), gains)
    assert float(gradient.abs().max()) > 0


def test_turns_of_colours_have_a_gradient() -> None:
    draw = torch.Generator().manual_seed(0)
    maps = torch.eye(3, dtype=torch.float64) + 0.3 * torch.randn(
        5, 3, 3, generator=draw, dtype=torch.float64
    )
    maps[0] *= torch.tensor([1.0, 1.0, -1.0])  # One that mirrors.
    maps[1] = 2 * torch.eye(3)  # One whose axes are equally long.
    assert torch.autograd.gradcheck(polar, maps.requires_grad_(True), eps=1e-6, atol=1e-6)


@pytest.mark.parametrize("fast", [False, True])
def test_a_batch_is_its_pictures(fast: bool) -> None:
    """Far ones too, whose pixels are divided: they change nothing of those nearby."""
    assert isinstance(ASSET.content, GaussianContent)
    fine = replace(ASSET.content, footprint=Footprint(pixel=2.6 / 16))
    asset = replace(ASSET, content=fine)
    far = camera(place=torch.tensor([0.0, 0.0, 900.0], dtype=torch.float64))
    cameras = [camera(), camera(18.0), far]
    batch = asset.render(None, Camera.stack(cameras), fast=fast)
    assert batch.rgb.shape == (3, 9, 12, 3)
    for index, one in enumerate(cameras):
        alone = asset.render(None, one, fast=fast)
        assert torch.equal(batch.rgb[index], alone.rgb)
        assert torch.equal(batch.depth[index].isnan(), alone.depth.isnan())


def test_nothing_is_followed_that_does_not_ask() -> None:
    assert not ASSET.render(None, camera()).rgb.requires_grad

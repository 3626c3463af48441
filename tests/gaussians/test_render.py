"""Pictures of Gaussians: cameras as everywhere in pcore, posing, gains, gradients to everything."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.gaussians.carry import carried
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.pinhole import surface_points, view_matrices
from pcore.gaussians.render import (
    PIXEL,
    Footprint,
    PosedGaussians,
    pose,
    render,
    render_views,
)
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

FOOTPRINT = Footprint()


def some_gaussians(
    count: int = 80, degree: int = 2, dtype: torch.dtype = torch.float32
) -> Gaussians:
    draw = torch.Generator().manual_seed(4)
    return Gaussians(
        means=0.5 * torch.randn(count, 3, generator=draw, dtype=dtype),
        quats=torch.nn.functional.normalize(
            torch.randn(count, 4, generator=draw, dtype=dtype), dim=-1
        ),
        scales=0.02 + 0.1 * torch.rand(count, 3, generator=draw, dtype=dtype),
        opacities=torch.rand(count, generator=draw, dtype=dtype),
        sh=0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=draw, dtype=dtype),
    )


def cameras(count: int = 3, size: int = 32) -> list[Camera]:
    return orbit_cameras(
        torch.tensor([0.1, 0.0, -0.1]),
        4.0,
        count,
        elevation=0.5,
        width=size,
        height=size - 5,
        angle_x=0.7,
    )


def one(position: list[float], camera: Camera, scale: float = 0.05) -> tuple[Tensor, Tensor]:
    """Alpha and depth of one opaque Gaussian."""
    gaussians = Gaussians(
        means=torch.tensor([position]),
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        scales=torch.full((1, 3), scale),
        opacities=torch.tensor([0.99]),
        sh=torch.zeros(1, 1, 3),
    )
    found = render(PosedGaussians(gaussians=gaussians), [camera], footprint=FOOTPRINT)
    return found.alpha[0], found.depth[0]


def test_a_gaussian_lies_where_the_camera_projects_its_centre() -> None:
    for camera in cameras():
        position = [0.3, -0.2, 0.25]
        alpha, depth = one(position, camera)
        column, row, z = camera.project(torch.tensor([position]))
        rows, columns = torch.meshgrid(
            torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
        )
        middle = [float((alpha * one).sum() / alpha.sum()) for one in (columns, rows)]
        assert middle == pytest.approx([float(column), float(row)], abs=0.05)
        at = int(row), int(column)
        assert float(depth[at]) == pytest.approx(float(z), rel=1e-5)
        point = surface_points(depth, camera)[at]
        assert float((point - torch.tensor(position)).norm()) < camera.pixel_width(point)


def test_what_a_gaussian_covers_stays_when_it_is_far_smaller_than_a_pixel() -> None:
    """Antialiased: alpha sums to 2 pi sigma^2 o at any size, wherever between the pixels it is."""
    camera = cameras()[0]
    pixel = camera.pixel_width(torch.zeros(3))
    for scale in (0.1, 0.01):
        sums = [
            float(one([0.0, pixel * i / 5, pixel * j / 5], camera, scale)[0].sum())
            for i in range(5)
            for j in range(5)
        ]
        expected = 0.99 * 2 * math.pi * (scale / pixel) ** 2
        # Fainter than 1 / 255 nothing is drawn.
        assert sum(sums) / len(sums) == pytest.approx(expected, rel=0.06)
    assert pytest.approx(1 / 12) == PIXEL


def test_pictures_of_a_batch_are_those_of_single_cameras() -> None:
    posed = PosedGaussians(gaussians=some_gaussians())
    together = render(posed, cameras(), footprint=FOOTPRINT)
    for index, camera in enumerate(cameras()):
        alone = render(posed, [camera], footprint=FOOTPRINT)
        torch.testing.assert_close(together.rgb[index], alone.rgb[0], rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(together.depth[index], alone.depth[0], rtol=1e-6, atol=1e-6)


def test_a_rigid_motion_of_everything_changes_nothing() -> None:
    """Colours included: they turn along."""
    gaussians = some_gaussians()
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    turn = (turn * torch.linalg.det(turn)).float()
    shift = torch.tensor([0.4, -2.0, 1.0])
    moved = pose(gaussians, gaussians.means @ turn.T + shift, turn.expand(len(gaussians), 3, 3))
    rigid = torch.eye(4)
    rigid[:3, :3], rigid[:3, 3] = turn, shift
    for camera in cameras():
        followed = camera.moved(rigid @ camera.world_from_camera)
        before = render(PosedGaussians(gaussians=gaussians), [camera], footprint=FOOTPRINT)
        after = render(moved, [followed], footprint=FOOTPRINT)
        assert float((before.rgb - after.rgb).abs().max()) < 2e-3
        assert float((before.rgb - after.rgb).abs().mean()) < 1e-5


def test_units_do_not_matter() -> None:
    gaussians, camera = some_gaussians(), cameras()[0]
    before = render(PosedGaussians(gaussians=gaussians), [camera], footprint=FOOTPRINT)
    for factor in (1e-3, 1e3):
        placed = camera.world_from_camera.clone()
        placed[:3, 3] *= factor
        scaled = replace(
            gaussians, means=factor * gaussians.means, scales=factor * gaussians.scales
        )
        after = render(
            PosedGaussians(gaussians=scaled), [camera.moved(placed)], footprint=FOOTPRINT
        )
        assert float((before.rgb - after.rgb).abs().mean()) < 1e-5
        torch.testing.assert_close(after.depth / factor, before.depth, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    "footprint", [Footprint(flat=True), Footprint(flat=True, variance=0.5, antialiased=False)]
)
def test_flat_ones_are_posed_by_their_tangents_and_have_normals(footprint: Footprint) -> None:
    """What is drawn of an edit is what is drawn of the discs that are written out."""
    gaussians = some_gaussians()
    thin = gaussians.scales * torch.tensor([1.0, 1.0, 1e-4])
    gaussians = replace(gaussians, scales=thin)
    maps = torch.eye(3) + 0.3 * torch.randn(len(gaussians), 3, 3)
    positions = gaussians.means + 0.1
    drawn = render(pose(gaussians, positions, maps), cameras(), footprint=footprint)
    written = PosedGaussians(gaussians=carried(gaussians, positions, maps))
    truth = render(written, cameras(), footprint=footprint)
    assert float((drawn.rgb - truth.rgb).abs().mean()) < 1e-4
    assert drawn.normals is not None
    assert truth.normals is not None
    assert float((drawn.normals - truth.normals).abs().mean()) < 1e-3
    assert float((drawn.normals.norm(dim=-1) - drawn.alpha).max()) < 1e-4


def test_posing_is_carrying() -> None:
    """The fast way of drawing edits shows what the Gaussians that are written out show."""
    gaussians = some_gaussians()
    maps = torch.eye(3) + 0.3 * torch.randn(len(gaussians), 3, 3)
    positions = gaussians.means + 0.1
    drawn = render(pose(gaussians, positions, maps), cameras(), footprint=FOOTPRINT)
    written = PosedGaussians(gaussians=carried(gaussians, positions, maps))
    truth = render(written, cameras(), footprint=FOOTPRINT)
    assert float((drawn.rgb - truth.rgb).abs().mean()) < 1e-4


def test_gains_are_factors_on_the_colours() -> None:
    gaussians, camera = some_gaussians(), cameras()[0]
    black = torch.zeros(3)
    plain, lit = (
        render(
            PosedGaussians(gaussians=gaussians, gains=gains),
            [camera],
            footprint=FOOTPRINT,
            background=black,
        ).rgb
        for gains in (None, torch.tensor([[0.5, 1.0, 2.0]]).expand(len(gaussians), 3))
    )
    torch.testing.assert_close(lit, plain * torch.tensor([0.5, 1.0, 2.0]))


def test_gradients_reach_everything() -> None:
    """Means, shapes, colours, gains, maps, pose and focal length, against finite differences."""
    gaussians = some_gaussians(6, 1, torch.float64)
    # Wider than the picture, so that nothing crosses the edge where it ends.
    gaussians = replace(
        gaussians, scales=gaussians.scales + 2, opacities=0.3 * gaussians.opacities + 0.2
    )
    viewmats, intrinsics = view_matrices(cameras(2, 12), gaussians.means)
    maps = torch.eye(3, dtype=torch.float64).expand(6, 3, 3).contiguous()
    gains = torch.rand(6, 3, dtype=torch.float64)

    def picture(
        means: Tensor,
        opacities: Tensor,
        sh: Tensor,
        maps: Tensor,
        gains: Tensor,
        shift: Tensor,
        focal: Tensor,
    ) -> Tensor:
        moved = replace(gaussians, opacities=opacities, sh=sh)
        views = torch.cat([viewmats[:, :3, :3], viewmats[:, :3, 3:] + shift[:, None]], dim=-1)
        views = torch.cat([views, viewmats[:, 3:]], dim=1)
        lens = intrinsics * torch.stack([focal, focal, torch.ones_like(focal)])[:, None]
        lens = torch.cat([lens[..., :2], intrinsics[..., 2:]], dim=-1)
        posed = PosedGaussians(
            gaussians=replace(moved, means=means),
            axes=pose(moved, means, maps).axes,
            gains=gains,
        )
        found = render_views(posed, views, lens, (12, 7), footprint=FOOTPRINT)
        return torch.stack([found.rgb.sin().sum(), found.depth.mean()])

    given = (gaussians.means, gaussians.opacities, gaussians.sh, maps, gains)
    given += (torch.zeros(3, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64))
    leaves = [tensor.clone().requires_grad_() for tensor in given]
    assert torch.autograd.gradcheck(picture, leaves, eps=1e-6, atol=1e-4, rtol=1e-3)


def test_a_pose_of_a_camera_gets_gradient() -> None:
    camera = cameras()[0]
    leaf = camera.world_from_camera.clone().requires_grad_()
    found = render(
        PosedGaussians(gaussians=some_gaussians()), [camera.moved(leaf)], footprint=FOOTPRINT
    )
    found.rgb.square().mean().backward()
    assert leaf.grad is not None
    assert float(leaf.grad[:3].abs().max()) > 0


def test_bad_requests_are_refused() -> None:
    posed = PosedGaussians(gaussians=some_gaussians())
    with pytest.raises(InputError, match="one picture size"):
        render(posed, [], footprint=FOOTPRINT)
    with pytest.raises(InputError, match="one picture size"):
        render(posed, [*cameras(1), *cameras(1, 40)], footprint=FOOTPRINT)
    with pytest.raises(InputError, match="variance above 0"):
        Footprint(variance=0.0)

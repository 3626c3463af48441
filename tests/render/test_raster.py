"""The renderer network sees pixels of the size it was trained on, whatever the picture's size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import tiny_scene
from pcore.deform.jacobian import estimated_maps
from pcore.deform.pose import pose
from pcore.deform.simple import uniform_scale
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.render.picture import render
from pcore.render.progressive import render_progressively
from pcore.render.raster import film_detail, photo_pixels, raster_of
from pcore.render.tiles import mean_around

DISTANCE, SIZE = 4.0, 40
FOCAL = 60.0
CONFIG = replace(tiny_scene.CONFIG, samples=4, cutoff=0.3, pixel=DISTANCE / FOCAL)


def ball() -> PosedCloud:
    draw = torch.Generator().manual_seed(4)
    half = torch.nn.functional.normalize(torch.randn(200, 3, generator=draw), dim=-1)
    cloud = PointCloud(
        positions=torch.cat([half, -half]),
        features=torch.randn(400, 4, generator=draw),
        influence=torch.ones(400),
    )
    return PosedCloud.at_rest(cloud)


def camera(factor: float = 1.0, distance: float = DISTANCE) -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = distance
    size = round(factor * SIZE)
    return Camera(
        world_from_camera=pose,
        width=size,
        height=size,
        fx=factor * FOCAL,
        fy=factor * FOCAL,
        cx=size / 2,
        cy=size / 2,
    )


def network(**changes: Any) -> Papr:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return Papr(replace(CONFIG, **changes)).requires_grad_(False).eval()


@pytest.mark.parametrize(
    ("factor", "step", "pool", "rays"),
    [
        (1.0, 1, 1, 4),
        (1.3, 1, 1, 4),
        (2.0, 2, 1, 4),
        (3.4, 3, 1, 4),
        (0.9, 1, 1, 4),
        (0.5, 1, 2, 1),
    ],
)
def test_what_a_picture_of_another_size_is_made_of(
    factor: float, step: int, pool: int, rays: int
) -> None:
    view = camera(factor)
    raster = raster_of(CONFIG, ball(), view, None, 256)
    assert (raster.step, raster.pool, len(raster.places)) == (step, pool, rays)
    assert raster.size == (pool * view.height, pool * view.width)
    assert raster.tile % (4 * step) == 0
    assert raster.margin % (4 * step) == 0


def test_who_says_how_many_rays_gets_no_larger_picture_than_they_make() -> None:
    assert raster_of(CONFIG, ball(), camera(0.5), 1, 256).pool == 1
    nine = raster_of(CONFIG, ball(), camera(0.34), 9, 256)
    assert (nine.pool, len(nine.places)) == (3, 1)
    nine = raster_of(CONFIG, ball(), camera(0.5), 9, 256)
    assert (nine.pool, len(nine.places)) == (2, 4)


def test_a_small_picture_is_not_cut_into_lattices_that_the_network_cannot_take() -> None:
    view = replace(camera(8.0), width=11, height=20)
    assert raster_of(CONFIG, ball(), view, None, 256).step == 2


def test_models_that_do_not_know_their_photos_draw_as_ever() -> None:
    config = replace(CONFIG, pixel=None)
    for factor in (0.3, 5.0):
        raster = raster_of(config, ball(), camera(factor), None, 64)
        assert (raster.step, raster.pool, raster.tile) == (1, 1, 64)
    with pytest.raises(InputError, match="rays per pixel that make a square"):
        raster_of(config, ball(), camera(), 3, 64)


def test_what_counts_is_the_size_of_pixels_on_the_object() -> None:
    points = ball()
    assert photo_pixels(CONFIG, points, camera()) == pytest.approx(1.0, abs=0.01)
    assert photo_pixels(CONFIG, points, camera(distance=8.0)) == pytest.approx(0.5, abs=0.01)
    # From among the points: as from half their radius before the middle one.
    for distance in (0.3, 0.0, -3.0):
        assert photo_pixels(CONFIG, points, camera(distance=distance)) == pytest.approx(8, rel=0.02)
    floater = replace(points, positions=points.positions.index_fill(0, torch.tensor([7]), -6.0))
    assert photo_pixels(CONFIG, floater, camera()) == pytest.approx(1.0, abs=0.02)
    larger = pose(points.cloud, uniform_scale(2.0))
    assert photo_pixels(CONFIG, larger, camera(distance=8.0)) == pytest.approx(1.0, abs=0.01)
    plain = pose(points.cloud, uniform_scale(2.0), aware=False)
    assert photo_pixels(CONFIG, plain, camera(distance=8.0)) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("aware", [True, False])
def test_a_folded_pose_is_as_large_as_before(aware: bool) -> None:
    points = ball()
    lifted = points.positions[:, 0].abs() > 0.6
    shift = torch.tensor([-0.5, 0.0, 0.0]) * points.positions[:, :1].sign() * lifted[:, None]
    moved = points.positions + shift
    maps = estimated_maps(points.positions, moved) if aware else None
    folded = replace(points, positions=moved, local_maps=maps)
    assert folded.growth == pytest.approx(1.0, abs=0.03)


@torch.no_grad()
def test_lattices_are_pictures_of_the_size_of_the_photos() -> None:
    """With a network that looks at its neighbours, at twice the size."""
    papr, seen = network(), list[Tensor]()
    papr.unet.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    picture = render(papr, ball(), camera(2.0))
    # Its rim is repeated by 4 pixels of the photos on every side.
    assert [tuple(one.shape[-2:]) for one in seen] == [(SIZE + 8, SIZE + 8)] * 4
    assert picture.rgb.shape == (2 * SIZE, 2 * SIZE, 3)
    # Lattices of the same object beside each other: alike.
    first, last = seen[0], seen[3]
    apart = (first - last).square().mean() / first.var()
    assert float(apart) < 0.3


@torch.no_grad()
@pytest.mark.parametrize("factor", [2.0, 3.0, 0.5])
def test_tiles_and_chunks_change_nothing(factor: float) -> None:
    papr, points, view = network(), ball(), camera(factor)
    whole = render(papr, points, view, tile=4096)
    parts = render(papr, points, view, tile=16, max_rays=700)
    torch.testing.assert_close(parts.rgb, whole.rgb, atol=1e-5, rtol=0)
    torch.testing.assert_close(parts.alpha, whole.alpha, atol=1e-5, rtol=0)
    torch.testing.assert_close(parts.depth, whole.depth, atol=1e-4, rtol=0, equal_nan=True)
    *_, last = render_progressively(papr, points, view)
    assert torch.equal(last.rgb, whole.rgb)


def test_what_the_network_sees_of_fine_pictures_is_the_mean_of_a_photos_pixel() -> None:
    dot = torch.zeros(9, 9, 1)
    dot[4, 4] = 1.0
    three, four = mean_around(dot, 3)[..., 0], mean_around(dot, 4)[..., 0]
    torch.testing.assert_close(three[3:6, 3:6], torch.full((3, 3), 1 / 9))
    assert float(three.sum()) == pytest.approx(1.0)
    row = torch.tensor([0, 0, 0.5, 1, 1, 1, 0.5, 0, 0]) / 4
    torch.testing.assert_close(four, torch.outer(row, row))


@torch.no_grad()
def test_the_rim_of_a_picture_is_no_frame() -> None:
    """A picture that cuts through the object is that part of a larger one."""
    papr, points, wide = network(), ball(), camera(4.0)
    part = replace(wide, width=80, height=80, cx=wide.cx - 40, cy=wide.cy - 40)
    whole = render(papr, points, wide).rgb[40:120, 40:120]
    error = (render(papr, points, part).rgb - whole).square().mean(dim=-1)
    ring = torch.ones(80, 80, dtype=torch.bool)
    ring[4:-4, 4:-4] = False
    spread = float(whole.var())
    assert float(error[ring].mean()) < 0.1 * spread
    assert float(error[~ring].mean()) < 0.01 * spread


def evenly(points: PosedCloud, gain: float) -> PosedCloud:
    """All of a surface that many times as bright."""
    surfels = Surfels(
        places=points.positions,
        normals=torch.nn.functional.normalize(points.positions, dim=1),
        heights=torch.zeros(len(points)),
        beside=torch.arange(len(points))[:, None],
        spacing=0.1,
    )
    return replace(points, surfels=surfels, gains=torch.full((len(points),), gain))


@torch.no_grad()
def test_light_falls_on_fine_pictures() -> None:
    papr, points, view = network(), ball(), camera(2.0)
    bright = render(papr, evenly(points, 2.0), view)
    once = render(papr, points, view)
    background = torch.tensor(papr.config.background) * (1 - once.alpha.unsqueeze(-1))
    torch.testing.assert_close(bright.rgb - background, 2 * (once.rgb - background))


def test_a_film_has_one_size_of_pixels() -> None:
    points, near, far = ball(), camera(1.55), camera(1.45)
    steps = {raster_of(CONFIG, points, one, None, 64).step for one in (near, far)}
    assert steps == {1, 2}
    detail = film_detail(CONFIG, [points] * 3, [near, far, far])
    assert detail == pytest.approx(1.45, abs=0.02)
    steps = {raster_of(CONFIG, points, one, None, 64, detail).step for one in (near, far)}
    assert steps == {1}


@pytest.mark.parametrize("pixel", [0.0, -1.0, float("nan"), float("inf")])
def test_pixels_have_a_width(pixel: float) -> None:
    with pytest.raises(InputError, match=r"pixel of the photos wider than 0"):
        replace(CONFIG, pixel=pixel)


def test_poses_grow_against_the_points_at_rest() -> None:
    points = ball()
    assert points.growth == points.to("cpu").growth == 1.0
    assert replace(points, positions=3 * points.positions).growth == pytest.approx(3.0)


@torch.no_grad()
def test_a_coarse_picture_is_the_mean_of_a_larger_one() -> None:
    papr, points = network(), ball()
    small, large = render(papr, points, camera(0.5)), render(papr, points, camera(), samples=1)
    blocks = large.rgb.unflatten(0, (-1, 2)).unflatten(2, (-1, 2))
    torch.testing.assert_close(small.rgb, blocks.mean(dim=(1, 3)), atol=1e-6, rtol=0)
    assert small.surface.shape == (SIZE // 2, SIZE // 2, 3)
    hit = ~small.surface.isnan().any(dim=-1)
    assert int(hit.sum()) > 60
    assert torch.equal(hit, small.alpha > 0)
    torch.testing.assert_close(small.depth[hit], camera(0.5).depth(small.surface[hit]))


@pytest.mark.parametrize("width", [1, 2, 3, 4, 7])
def test_means_are_those_of_a_convolution(width: int):
    features = torch.rand(12, 15, 5)
    reach = width // 2
    weights = torch.ones(2 * reach + 1)
    if width % 2 == 0:
        weights[[0, -1]] = 0.5
    kernel = (weights.unsqueeze(1) * weights / width**2).expand(5, 1, -1, -1)
    planes = features.permute(2, 0, 1).unsqueeze(0)
    expected = torch.nn.functional.conv2d(planes, kernel, padding=reach, groups=5)[0]
    torch.testing.assert_close(mean_around(features, width), expected.permute(1, 2, 0))

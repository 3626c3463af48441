"""The renderer network sees pixels of the size it was trained on, whatever the picture's size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

import tiny_scene
from pcore.deform.local_frames import estimated_frames
from pcore.deform.simple import uniform_scale
from pcore.editing.apply import deformed_cloud
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.model.progressive import render_progressively
from pcore.model.raster import photo_pixels, raster_of
from pcore.model.render import render

DISTANCE, SIZE = 4.0, 40
FOCAL = 60.0
CONFIG = replace(tiny_scene.CONFIG, samples=4, cutoff=0.3, pixel=DISTANCE / FOCAL)


def cloud() -> PointCloud:
    draw = torch.Generator().manual_seed(4)
    places = torch.nn.functional.normalize(torch.randn(400, 3, generator=draw), dim=-1)
    return PointCloud(
        positions=places,
        features=torch.randn(400, 4, generator=draw),
        influence=torch.ones(400),
    )


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
        return Papr(replace(CONFIG, **changes)).eval()


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
    raster = raster_of(CONFIG, cloud(), view, None, 256)
    assert (raster.step, raster.pool, len(raster.places)) == (step, pool, rays)
    assert raster.size == (pool * view.height, pool * view.width)
    assert raster.tile % (4 * step) == 0
    assert raster.margin % (4 * step) == 0


def test_with_one_ray_per_pixel_no_larger_picture_is_drawn() -> None:
    assert raster_of(CONFIG, cloud(), camera(0.5), 1, 256).pool == 1
    nine = raster_of(CONFIG, cloud(), camera(0.34), 9, 256)
    assert (nine.pool, len(nine.places)) == (3, 1)


def test_a_small_picture_is_not_cut_into_lattices_that_the_network_cannot_take() -> None:
    view = replace(camera(8.0), width=11, height=20)
    assert raster_of(CONFIG, cloud(), view, None, 256).step == 2


def test_models_that_do_not_know_their_photos_draw_as_ever() -> None:
    config = replace(CONFIG, pixel=None)
    for factor in (0.3, 5.0):
        raster = raster_of(config, cloud(), camera(factor), None, 64)
        assert (raster.step, raster.pool, raster.tile) == (1, 1, 64)
    with pytest.raises(InputError, match="rays per pixel that make a square"):
        raster_of(config, cloud(), camera(), 3, 64)


def test_what_counts_is_the_size_of_pixels_on_the_object() -> None:
    points = cloud()
    assert photo_pixels(CONFIG, points, camera()) == pytest.approx(1.0, abs=0.01)
    assert photo_pixels(CONFIG, points, camera(distance=8.0)) == pytest.approx(0.5, abs=0.01)
    # Seen from among the points nothing is known.
    assert photo_pixels(CONFIG, points, camera(distance=0.5)) == 1.0
    larger = deformed_cloud(points, uniform_scale(2.0))
    assert photo_pixels(CONFIG, larger, camera(distance=8.0)) == pytest.approx(1.0, abs=0.01)
    plain = deformed_cloud(points, uniform_scale(2.0), aware=False)
    assert photo_pixels(CONFIG, plain, camera(distance=8.0)) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("aware", [True, False])
def test_a_folded_pose_is_as_large_as_before(aware: bool) -> None:
    points = cloud()
    lifted = points.positions[:, 0].abs() > 0.6
    shift = torch.tensor([-0.5, 0.0, 0.0]) * points.positions[:, :1].sign() * lifted[:, None]
    moved = points.positions + shift
    frames = estimated_frames(points.positions, moved) if aware else None
    assert points.moved(moved, frames).growth == pytest.approx(1.0, abs=0.03)


@torch.no_grad()
def test_lattices_are_pictures_of_the_size_of_the_photos() -> None:
    """With a network that looks at its neighbours, at twice the size."""
    papr, seen = network(), list[Tensor]()
    papr.unet.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    picture = render(papr, cloud(), camera(2.0))
    assert [tuple(one.shape[-2:]) for one in seen] == [(SIZE, SIZE)] * 4
    assert picture.rgb.shape == (2 * SIZE, 2 * SIZE, 3)
    # Lattices of the same object beside each other: alike.
    first, last = seen[0], seen[3]
    apart = (first - last).square().mean() / first.var()
    assert float(apart) < 0.3


@torch.no_grad()
@pytest.mark.parametrize("factor", [2.0, 3.0, 0.5])
def test_tiles_and_chunks_change_nothing(factor: float) -> None:
    papr, points, view = network(), cloud(), camera(factor)
    whole = render(papr, points, view, tile=4096)
    parts = render(papr, points, view, tile=16, max_rays=700)
    torch.testing.assert_close(parts.rgb, whole.rgb, atol=1e-5, rtol=0)
    torch.testing.assert_close(parts.alpha, whole.alpha, atol=1e-5, rtol=0)
    torch.testing.assert_close(parts.depth, whole.depth, atol=1e-4, rtol=0, equal_nan=True)
    *_, last = render_progressively(papr, points, view)
    assert torch.equal(last.rgb, whole.rgb)


@torch.no_grad()
def test_a_coarse_picture_is_the_mean_of_a_larger_one() -> None:
    papr, points = network(), cloud()
    small, large = render(papr, points, camera(0.5)), render(papr, points, camera(), samples=1)
    blocks = large.rgb.unflatten(0, (-1, 2)).unflatten(2, (-1, 2))
    torch.testing.assert_close(small.rgb, blocks.mean(dim=(1, 3)), atol=1e-6, rtol=0)
    assert small.surface.shape == (SIZE // 2, SIZE // 2, 3)
    hit = ~small.surface.isnan().any(dim=-1)
    assert int(hit.sum()) > 60
    assert torch.equal(hit, small.alpha > 0)
    torch.testing.assert_close(small.depth[hit], camera(0.5).depth(small.surface[hit]))

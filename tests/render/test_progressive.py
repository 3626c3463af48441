"""Progressive rendering: coarse pictures early, the exact one last, no work after a cancel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from test_picture import camera, network

from pcore.errors import InputError
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.render import tiles as tiles_module
from pcore.render.image import Image
from pcore.render.picture import RenderCancelledError, render
from pcore.render.progressive import render_progressively
from pcore.render.trace import trace

PLANES = ("rgb", "alpha", "depth", "surface")


@pytest.fixture
def posed() -> PosedCloud:
    cloud = PointCloud(
        positions=torch.randn(60, 3) * 0.3,
        features=torch.randn(60, 6),
        influence=torch.rand(60) * 2,
    )
    return PosedCloud.at_rest(cloud)


@pytest.fixture
def attended(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many rays each call of the attention got."""
    rays: list[int] = []

    def counted(papr: Papr, posed: PosedCloud, bundle: Any, **options: Any) -> Any:
        rays.append(len(bundle.origins))
        return trace(papr, posed, bundle, **options)

    monkeypatch.setattr(tiles_module, "trace", counted)
    return rays


def same(one: Image, other: Image) -> bool:
    parts = [(getattr(one, name), getattr(other, name)) for name in PLANES]
    return all(torch.equal(a.nan_to_num(7.0), b.nan_to_num(7.0)) for a, b in parts)


@pytest.mark.parametrize(
    ("size", "tile", "max_rays", "pictures"),
    [
        ((100, 101), 32, 999, 2 + 4),
        ((37, 53), 16, 100, 2 + 4),
        ((34, 67), 20, None, 2 + 4),
        ((40, 40), 256, None, 2 + 1),
        ((20, 19), 8, 50, 1 + 3),
        ((6, 5), 4, 7, 1),
    ],
)
def test_the_last_picture_is_what_render_gives_bit_for_bit(
    posed: PosedCloud, size: tuple[int, int], tile: int, max_rays: int | None, pictures: int
) -> None:
    papr, cam = network(cutoff=0.3), camera(*size)
    shown = list(render_progressively(papr, posed, cam, tile=tile, max_rays=max_rays))
    assert same(shown[-1], render(papr, posed, cam, tile=tile, max_rays=max_rays))
    assert all(one.rgb.shape == (size[1], size[0], 3) for one in shown)
    assert len(shown) == pictures
    errors = [float((one.alpha - shown[-1].alpha).abs().mean()) for one in shown]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] > 0 or pictures == 1


def test_the_first_picture_comes_early_and_no_ray_is_attended_to_thrice(
    posed: PosedCloud, attended: list[int]
) -> None:
    stages = render_progressively(network(), posed, camera(100, 80), max_rays=300, tile=32)
    next(stages)
    assert sum(attended) == 13 * 10
    assert sum(attended) <= 0.02 * 100 * 80
    next(stages)
    assert sum(attended) == 25 * 20
    assert max(attended) == 300
    list(stages)
    assert sum(attended) == 25 * 20 + 100 * 80


def test_coarse_pictures_are_those_of_their_rays(posed: PosedCloud) -> None:
    papr, cam = network(), camera(48, 40)
    with torch.no_grad():
        exact = trace(papr, posed, cam.rays())
    alpha = (1 - exact.background).view(40, 48)
    surface = exact.centroid.view(40, 48, 3)
    for stage, stride in zip(render_progressively(papr, posed, cam), (8, 4), strict=False):
        grid = slice(2, None, stride)
        blocks = slice(0, None, stride)
        torch.testing.assert_close(stage.alpha[blocks, blocks], alpha[grid, grid])
        torch.testing.assert_close(stage.surface[blocks, blocks], surface[grid, grid])
        assert torch.equal(stage.rgb[:stride, :stride], stage.rgb[:1, :1].expand(stride, stride, 3))


def test_pictures_stay_as_they_are(posed: PosedCloud) -> None:
    papr, cam = network(), camera(40, 40)
    kept: list[tuple[Image, Image]] = []
    for stage in render_progressively(papr, posed, cam, tile=8):
        kept.append((stage, stage.each(torch.clone)))
    assert all(same(one, copy) for one, copy in kept)
    assert len(kept) == 2 + 5
    finished = [one for one, _ in kept[2:]]
    for rows, one in zip(range(8, 40, 8), finished, strict=False):
        assert torch.equal(one.rgb[:rows], finished[-1].rgb[:rows])
        assert not torch.equal(one.rgb[rows:], finished[-1].rgb[rows:])


def test_cancelling_between_chunks(posed: PosedCloud, attended: list[int]) -> None:
    seen: list[Image] = []
    stages = render_progressively(
        network(), posed, camera(64, 64), max_rays=100, cancel=lambda: bool(seen)
    )
    with pytest.raises(RenderCancelledError, match="cancelled before it was complete"):
        seen.extend(stages)
    assert len(seen) == 1
    assert sum(attended) == 64


def test_closing_the_generator_ends_the_work(posed: PosedCloud, attended: list[int]) -> None:
    stages: Iterator[Image] = render_progressively(network(), posed, camera(64, 64))
    next(stages)
    assert torch.is_grad_enabled()
    stages.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert sum(attended) == 64


def test_what_asks_for_a_gradient_is_refused(posed: PosedCloud) -> None:
    """Such pictures have none."""
    posed.cloud.positions.requires_grad_()
    with pytest.raises(InputError, match="nothing that asks for a gradient"):
        next(render_progressively(network(), posed, camera(40, 40)))
    with torch.no_grad():
        next(render_progressively(network(), posed, camera(40, 40)))


@pytest.mark.parametrize("strides", [(8, 3), (4, 8), (8, 1)])
def test_strides_that_do_not_fit(posed: PosedCloud, strides: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="each a multiple of the next"):
        next(render_progressively(network(), posed, camera(40, 40), strides=strides))


def test_other_strides_and_a_threshold(posed: PosedCloud) -> None:
    papr, cam = network(), camera(40, 40)
    shown = list(render_progressively(papr, posed, cam, strides=(6, 2), threshold=0.3))
    assert same(shown[-1], render(papr, posed, cam, threshold=0.3))
    assert len(list(render_progressively(papr, posed, cam, strides=()))) == 1

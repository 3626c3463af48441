"""Pixels wider than those of the photos: when they are divided, and what is then drawn."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, pose, render
from pcore.gaussians.wide_pixels import parts_of_pixels, pixel_width, render_divided
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

WHITE = torch.ones(3)


def camera(size: int = 24, radius: float = 4.0) -> Camera:
    (found,) = orbit_cameras(
        torch.zeros(3), radius, 1, elevation=0.3, width=size, height=size, angle_x=0.7
    )
    return found


@pytest.fixture
def gaussians() -> Gaussians:
    return some_gaussians(30)


@pytest.fixture
def footprint(gaussians: Gaussians) -> Footprint:
    return Footprint(pixel=pixel_width(gaussians, camera()))


def parts(gaussians: Gaussians, seen: Camera, footprint: Footprint, grown: float = 1.0) -> int:
    maps = grown * torch.eye(3).expand(len(gaussians), 3, 3)
    return parts_of_pixels(pose(gaussians, grown * gaussians.means, maps), seen, footprint)


def test_pixels_are_divided_to_the_width_of_the_photos(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    known = [parts(gaussians, camera(size), footprint) for size in (48, 24, 21, 20, 12, 8)]
    assert known == [1, 1, 1, 2, 2, 3]
    assert parts(gaussians, camera(radius=8.0), footprint) == 2
    assert parts_of_pixels(PosedGaussians(gaussians=gaussians), camera(12), footprint) == 2


def test_what_an_edit_shrinks_is_seen_by_wider_pixels(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    assert parts(gaussians, camera(), footprint, grown=0.5) == 2
    assert parts(gaussians, camera(radius=8.0), footprint, grown=2.0) == 1


def test_unknown_widths_divide_nothing_and_far_ones_not_without_end(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    assert parts(gaussians, camera(2), Footprint()) == 1
    assert parts(gaussians, camera(radius=4e4), footprint) == 7
    assert parts(gaussians, camera(1200, radius=4e6), footprint) == 2


def test_a_divided_picture_is_the_mean_of_the_finer_one(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    means = gaussians.means.clone().requires_grad_()
    posed = PosedGaussians(gaussians=replace(gaussians, means=means))
    fine = render(posed, [camera(24)], footprint=footprint, background=WHITE)
    found = render_divided(posed, camera(12), footprint=footprint, background=WHITE)

    def mean(values: torch.Tensor) -> torch.Tensor:
        return values.reshape(1, 12, 2, 12, 2, -1).mean(dim=(2, 4)).squeeze(-1)

    torch.testing.assert_close(found.rgb, mean(fine.rgb))
    torch.testing.assert_close(found.alpha, mean(fine.alpha))
    found.rgb.square().sum().backward()
    assert means.grad is not None
    assert bool((means.grad != 0).any())


def test_the_depth_of_a_divided_pixel_is_that_of_one_of_its_parts(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    """Where half of the opacity of its parts, from the nearest on, is reached; by counting."""
    posed = PosedGaussians(gaussians=gaussians)
    fine = render(posed, [camera(24)], footprint=footprint, background=WHITE)
    found = render_divided(posed, camera(12), footprint=footprint, background=WHITE)
    mixed = 0
    for row in range(12):
        for column in range(12):
            part = (0, slice(2 * row, 2 * row + 2), slice(2 * column, 2 * column + 2))
            depths, opacity = fine.depth[part].flatten().tolist(), fine.alpha[part].flatten()
            total, expected = 0.0, 0.0
            for depth, share in sorted(zip(depths, opacity.tolist(), strict=True)):
                if total < float(opacity.sum()) / 2:
                    expected = depth
                total += share
            assert float(found.depth[0, row, column]) == pytest.approx(expected)
            mixed += len({*depths}) > 2
    assert mixed > 10


def test_a_picture_as_fine_as_the_photos_is_drawn_as_before(
    gaussians: Gaussians, footprint: Footprint
) -> None:
    posed = PosedGaussians(gaussians=gaussians)
    found = render_divided(posed, camera(), footprint=footprint, background=WHITE)
    assert torch.equal(found.rgb, render(posed, [camera()], footprint=Footprint()).rgb)


@pytest.mark.parametrize("pixel", [0.0, -1.0, float("inf")])
def test_widths_that_are_none(pixel: float) -> None:
    with pytest.raises(InputError, match="finite width of a pixel above 0"):
        Footprint(pixel=pixel)

"""Photos of a training from coarse to fine."""

from __future__ import annotations

import pytest
import torch

from pcore.data.images import area_downscale
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.training.photo_level import PhotoLevel
from pcore.training.schedule import Level, check_levels
from small_training import FakeView


def view(width: int = 12, height: int = 8) -> FakeView:
    pixels = torch.rand(height, width, 4, generator=torch.Generator().manual_seed(0))
    camera = Camera.from_fov(torch.eye(4), width=width, height=height, angle_x=0.7)
    return FakeView(camera=camera, pixels=pixels)


def test_photos_are_area_means_and_cameras_shrink_along() -> None:
    whole = view()
    level = PhotoLevel(views=[whole], reduction=4)  # pyright: ignore[reportArgumentType]
    expected = area_downscale(whole.pixels, 4)
    torch.testing.assert_close(level.rgba(0), expected, atol=1e-5, rtol=0)
    camera = level.camera(0)
    assert (camera.width, camera.height, camera.cx) == (3, 2, 1.5)
    assert camera.focal[0] == pytest.approx(whole.camera.focal[0] / 4)


def test_sides_need_not_be_divisible() -> None:
    level = PhotoLevel(views=[view(13, 7)], reduction=4)  # pyright: ignore[reportArgumentType]
    assert tuple(level.rgba(0).shape) == (2, 3, 4)
    _, _, size = level.matrices(0, torch.zeros(1))
    assert size == (3, 2)


def test_whole_photos_are_those_of_the_scene() -> None:
    whole = view()
    level = PhotoLevel(views=[whole], reduction=1)  # pyright: ignore[reportArgumentType]
    assert torch.equal(level.rgba(0), whole.pixels)
    assert level.camera(0) is whole.camera


def test_levels_that_do_not_follow_one_another_are_refused() -> None:
    with pytest.raises(InputError, match="one after another"):
        check_levels([Level(until=0.5, reduction=2), Level(until=0.4, reduction=1)])
    with pytest.raises(InputError, match="whole numbers"):
        check_levels([Level(until=0.5, reduction=0)])

"""Photos of a training from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from pcore.data.images import area_downscale
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.training.reduced_view import PhotosInTurn, ReducedView
from pcore.training.schedule import Level, check_levels, reduction_at
from small_training import FakeView


def view(width: int = 12, height: int = 8) -> FakeView:
    pixels = torch.rand(height, width, 4, generator=torch.Generator().manual_seed(0))
    camera = Camera.from_fov(torch.eye(4), width=width, height=height, angle_x=0.7)
    return FakeView(camera=camera, pixels=pixels)


def test_photos_are_area_means_and_cameras_shrink_along() -> None:
    whole = view()
    small = ReducedView(view=whole, reduction=4)
    torch.testing.assert_close(small.rgba(), area_downscale(whole.pixels, 4), atol=1e-5, rtol=0)
    camera = small.camera
    assert (camera.width, camera.height, camera.cx) == (3, 2, 1.5)
    assert camera.focal[0] == pytest.approx(whole.camera.focal[0] / 4)
    assert small.valid() is None


def test_sides_need_not_be_divisible() -> None:
    small = ReducedView(view=view(13, 7), reduction=4)
    assert tuple(small.rgba().shape) == (2, 3, 4)
    assert (small.camera.width, small.camera.height) == (3, 2)


@dataclass(frozen=True)
class HalfValid(FakeView):
    def valid(self) -> Tensor:
        valid = torch.ones(8, 12, dtype=torch.bool)
        valid[:, :5] = False
        return valid


def test_a_reduced_pixel_is_valid_where_the_photo_shows_all_of_it() -> None:
    whole = view()
    valid = ReducedView(view=HalfValid(whole.camera, whole.pixels), reduction=4).valid()
    assert valid is not None
    assert valid.tolist() == [[False, False, True]] * 2


def test_a_training_sees_the_resolution_that_its_progress_asks_for() -> None:
    levels = (Level(until=0.25, reduction=4), Level(until=0.5, reduction=2))
    photos = PhotosInTurn([view()])
    seen = [photos.at(reduction_at(levels, at))[0].camera.width for at in (0.0, 0.3, 0.5, 1.0)]
    assert seen == [3, 6, 12, 12]
    assert photos.at(2)[0] is photos.at(2)[0]


def test_levels_that_do_not_follow_one_another_are_refused() -> None:
    with pytest.raises(InputError, match="one after another"):
        check_levels([Level(until=0.5, reduction=2), Level(until=0.4, reduction=1)])
    with pytest.raises(InputError, match="whole numbers"):
        check_levels([Level(until=0.5, reduction=0)])

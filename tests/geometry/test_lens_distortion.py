"""Bent lenses against OpenCV, and back."""

import math

import numpy as np
import pytest
import torch

from pcore.geometry.lens_distortion import LensDistortion

LENSES = {
    "fox": LensDistortion(
        fx=1375.52 / 8,
        fy=1374.49 / 8,
        cx=554.558 / 8,
        cy=965.268 / 8,
        k1=0.0578421,
        k2=-0.0805099,
        p1=-0.000980296,
        p2=0.00015575,
    ),
    "barrel": LensDistortion(fx=100, fy=100, cx=60, cy=110, k1=-0.2, k2=0.02, k3=0.01),
    "pincushion": LensDistortion(fx=110, fy=100, cx=70, cy=120, k1=0.1, p1=0.01, p2=-0.02),
}
WIDTH, HEIGHT = 135, 240


@pytest.mark.parametrize("name", LENSES)
def test_pixels_come_from_where_opencv_takes_them(name: str) -> None:
    cv2 = pytest.importorskip("cv2")
    lens = LENSES[name]
    # OpenCV's pixel centres lie at whole numbers.
    matrix = np.array([[lens.fx, 0, lens.cx - 0.5], [0, lens.fy, lens.cy - 0.5], [0, 0, 1]])
    numbers = np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    x, y = cv2.initUndistortRectifyMap(matrix, numbers, None, matrix, (WIDTH, HEIGHT), cv2.CV_32FC1)
    found, _ = lens.sources(WIDTH, HEIGHT)
    known = torch.from_numpy(np.stack([x, y], axis=-1)) + 0.5
    assert float((found - known).abs().max()) < 0.02


@pytest.mark.parametrize("name", LENSES)
def test_straightened_places_go_back(name: str) -> None:
    lens = LENSES[name]
    places = torch.rand(200, 2, dtype=torch.float64) * torch.tensor([WIDTH, HEIGHT])
    torch.testing.assert_close(lens.straightened(lens.bent(places)), places, atol=1e-6, rtol=0)


def test_pixels_that_the_lens_did_not_see_are_not_valid() -> None:
    _, barrel = LENSES["barrel"].sources(WIDTH, HEIGHT)
    _, pincushion = LENSES["pincushion"].sources(WIDTH, HEIGHT)
    assert bool(barrel.all()), "a barrel shows more than its straight picture"
    assert not bool(pincushion[0, 0])
    assert bool(pincushion[HEIGHT // 2, WIDTH // 2])


def test_a_polynomial_that_turns_back_shows_nothing_twice() -> None:
    lens = LensDistortion(fx=20, fy=20, cx=50, cy=50, k1=-0.3)
    assert lens.reach == pytest.approx(math.sqrt(1 / 0.9))
    _, valid = lens.sources(100, 100)
    assert not bool(valid[0, 0])
    assert not bool(valid[50, 95]), "it comes from inside of the picture, and the lens sees it not"
    assert bool(valid[50, 60])


def test_a_straight_lens_reaches_everywhere() -> None:
    lens = LensDistortion(fx=20, fy=20, cx=5, cy=5)
    assert lens.is_straight
    assert lens.reach == math.inf
    found, valid = lens.scaled(2, 3).sources(7, 6)
    assert bool(valid.all())
    torch.testing.assert_close(found[2, 3], torch.tensor([3.5, 2.5]))

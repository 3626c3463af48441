"""PSNR, SSIM and LPIPS against their definitions."""

import math
import sys

import numpy as np
import pytest
import torch

from pcore.errors import DependencyError, InputError
from pcore.metrics.image_metrics import (
    gaussian_ssim_map,
    lpips_distance,
    mean_ssim,
    psnr,
    uniform_ssim_map,
)
from pcore.metrics.perceptual import Lpips


@pytest.fixture
def pair():
    rng = np.random.default_rng(0)
    first = rng.random((24, 20, 3))
    return first, np.clip(first + 0.2 * rng.standard_normal(first.shape), 0, 1)


def test_psnr_of_a_known_error():
    assert psnr(torch.full((4, 5, 3), 0.6), torch.full((4, 5, 3), 0.5)) == pytest.approx(20.0)


def test_psnr_averages_squares_over_channels_before_the_logarithm():
    prediction = np.zeros((2, 2, 3))
    prediction[..., 0] = 0.3
    assert psnr(prediction, np.zeros((2, 2, 3))) == pytest.approx(-10 * math.log10(0.09 / 3))


def test_psnr_of_identical_images_is_infinite(pair):
    assert psnr(pair[0], pair[0]) == math.inf


def test_foreground_psnr_ignores_the_background():
    prediction, mask = np.full((4, 4, 3), 0.9), np.zeros((4, 4), dtype=bool)
    prediction[1, 2], mask[1, 2] = 0.1, True
    assert psnr(prediction, np.zeros((4, 4, 3)), mask) == pytest.approx(20.0)
    assert math.isnan(psnr(prediction, np.zeros((4, 4, 3)), np.zeros((4, 4), dtype=bool)))


def ssim_at(first, second, row, column, weights, correction):
    """SSIM of one pixel straight from the formula of Wang et al."""
    window = (slice(row - 5, row + 6), slice(column - 5, column + 6))
    values = []
    for channel in range(3):
        x, y = first[window][..., channel], second[window][..., channel]
        mx, my = (weights * x).sum(), (weights * y).sum()
        vx = correction * ((weights * x * x).sum() - mx**2)
        vy = correction * ((weights * y * y).sum() - my**2)
        vxy = correction * ((weights * x * y).sum() - mx * my)
        c1, c2 = 0.01**2, 0.03**2
        values.append((2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2)))
    return np.mean(values)


def test_uniform_ssim_is_the_formula(pair):
    weights = np.full((11, 11), 1 / 121)
    expected = ssim_at(*pair, 9, 8, weights, 121 / 120)
    assert uniform_ssim_map(*pair)[9, 8] == pytest.approx(expected, abs=1e-10)


def test_gaussian_ssim_is_the_formula(pair):
    line = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights = np.outer(line, line) / line.sum() ** 2
    expected = ssim_at(*pair, 9, 8, weights, 1.0)
    assert gaussian_ssim_map(*pair)[9, 8] == pytest.approx(expected, abs=1e-10)


def test_mean_ssim_leaves_out_mirrored_windows_and_obeys_the_mask():
    ssim_map = np.full((13, 13), -1.0)
    ssim_map[5:8, 5:8] = 0.5
    ssim_map[6, 6] = 0.9
    assert mean_ssim(ssim_map) == pytest.approx((8 * 0.5 + 0.9) / 9)
    mask = np.zeros((13, 13), dtype=bool)
    mask[6, 6] = mask[0, 0] = True
    assert mean_ssim(ssim_map, mask) == pytest.approx(0.9)
    mask[6, 6] = False
    assert math.isnan(mean_ssim(ssim_map, mask))


def test_ssim_of_identical_images_is_one(pair):
    assert mean_ssim(uniform_ssim_map(pair[0], pair[0])) == pytest.approx(1.0)
    assert mean_ssim(gaussian_ssim_map(pair[0], pair[0])) == pytest.approx(1.0)


def test_lpips_distance_is_the_network_on_mapped_images():
    network = Lpips("alex")
    first, second = torch.rand(2, 40, 33, 3)
    expected = network(*(x.permute(2, 0, 1)[None] * 2 - 1 for x in (first, second))).item()
    found = lpips_distance(network, first, second, lambda x: x * 2 - 1)
    assert found == pytest.approx(expected, rel=1e-5)
    assert lpips_distance(network, first, second, lambda x: x) != pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("metric", [psnr, uniform_ssim_map, gaussian_ssim_map])
def test_bad_images(metric):
    good = np.zeros((12, 12, 3))
    bad = good.copy()
    bad[0, 0, 0] = np.nan
    with pytest.raises(InputError, match=r"prediction: expected finite .* in 1 of"):
        metric(bad, good)
    with pytest.raises(InputError, match="prediction 12 x 12, target 13 x 12"):
        metric(good, np.zeros((12, 13, 3)))
    with pytest.raises(InputError, match=r"target: expected shape \(H, W, 3\), got \(12, 12\)"):
        metric(good, np.zeros((12, 12)))
    with pytest.raises(InputError, match=r"prediction: expected shape .* got \(0, 12, 3\)"):
        metric(np.zeros((0, 12, 3)), good)


def test_mask_of_another_size():
    with pytest.raises(InputError, match="prediction 3 x 2, mask 2 x 2"):
        psnr(np.zeros((2, 3, 3)), np.zeros((2, 3, 3)), np.zeros((2, 2), dtype=bool))


def test_image_too_small_for_ssim():
    with pytest.raises(InputError, match="at least 11 x 11 pixels, got 12 x 10"):
        uniform_ssim_map(np.zeros((10, 12, 3)), np.zeros((10, 12, 3)))


def test_missing_scikit_image(monkeypatch, pair):
    monkeypatch.setitem(sys.modules, "skimage.metrics", None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[metrics\]"):
        uniform_ssim_map(*pair)

"""The similarity that training uses against scikit-image's, and its gradient."""

from __future__ import annotations

import pytest
import torch

from pcore.metrics.image_metrics import gaussian_ssim_map
from pcore.training.ssim import ssim


def test_it_is_the_index_that_is_measured() -> None:
    """Away from the borders; there one mirrors, the other is black."""
    target = torch.rand(1, 40, 30, 3, dtype=torch.float64)
    target[:, :16] = target[:, 24:] = target[:, :, :12] = target[:, :, 18:] = 0
    image = 0.7 * target
    measured = gaussian_ssim_map(image[0], target[0]).mean()
    assert float(ssim(image, target)) == pytest.approx(measured, abs=1e-4)


def test_equal_pictures_are_most_similar() -> None:
    picture = torch.rand(2, 14, 17, 3, dtype=torch.float64)
    assert float(ssim(picture, picture)) == pytest.approx(1.0)
    assert float(ssim(picture, 1 - picture)) < 0.5


def test_its_gradient_is_that_of_finite_differences() -> None:
    target = torch.rand(1, 6, 5, 2, dtype=torch.float64)
    image = torch.rand(1, 6, 5, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: ssim(x, target), [image])

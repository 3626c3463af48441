"""How a place in a scene is written."""

import math

import pytest
import torch

from pcore.geometry.object_region import coordinates


@pytest.mark.parametrize("size", [0.003, 1.15, 2.3, 99.0, 100.0, 700.0])
@pytest.mark.parametrize("middle", [0.0, -0.2, 1600.0, -1600.0])
def test_a_hundredth_of_a_size_is_told_wherever_it_lies(size: float, middle: float) -> None:
    place = torch.tensor([middle - size, middle, middle + size / 3], dtype=torch.float64)
    written = [float(value) for value in coordinates(place, size).split(", ")]
    assert all(math.isfinite(value) for value in written)
    assert max(abs(a - b) for a, b in zip(written, place.tolist(), strict=True)) <= size / 200


def test_no_more_digits_than_that_needs() -> None:
    assert coordinates(torch.tensor([1598.8501, 0.0, -1.1499999]), 2.3) == "1598.85, 0, -1.15"
    assert coordinates(torch.tensor([0.81234567, 0.5, 12.0]), 2.0) == "0.8123, 0.5, 12"

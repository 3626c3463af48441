"""Holes, depth errors and spill on pictures small enough to count by hand."""

import math

import numpy as np
import pytest
import torch

from pcore.errors import InputError
from pcore.metrics.geometry_metrics import TrueGeometry, measure_geometry

SIZE = 2.0


@pytest.fixture
def truth():
    """A 4 x 5 solid object at depth 3 in a 10 x 10 picture, with a soft rim."""
    alpha, depth = np.zeros((10, 10)), np.full((10, 10), np.inf)
    alpha[2:8, 2:9] = 0.5
    alpha[3:7, 3:8] = 1.0
    depth[3:7, 3:8] = 3.0
    return TrueGeometry(alpha=alpha, depth=depth, object_size=SIZE)


def perfect(truth):
    return truth.alpha.copy(), np.where(np.isfinite(truth.depth), truth.depth, 0.0)


def test_a_perfect_picture(truth):
    scores = measure_geometry(*perfect(truth), truth)
    assert scores.hole_rate == 0
    assert scores.depth_error == 0
    assert scores.depth_error_relative == 0
    assert scores.spill == 0
    assert scores.spill_to_object == 0
    assert (scores.solid_pixels, scores.empty_pixels) == (20, 58)


def test_see_through_pixels_are_holes(truth):
    alpha, depth = perfect(truth)
    alpha[3, 3:5] = 0.49
    depth[3, 3:5] = np.nan
    scores = measure_geometry(alpha, depth, truth)
    assert scores.hole_rate == pytest.approx(2 / 20)
    assert scores.see_through_rate == pytest.approx(2 / 20)
    assert scores.depth_off_rate == 0
    assert scores.depth_error == 0


def test_wrong_depth_is_a_hole_beyond_five_percent_of_the_size(truth):
    alpha, depth = perfect(truth)
    depth[4, 3], depth[4, 4], depth[4, 5] = 3.11, 2.89, 3.09
    scores = measure_geometry(alpha, depth, truth)
    assert scores.hole_rate == pytest.approx(2 / 20)
    assert scores.depth_off_rate == pytest.approx(2 / 20)
    assert scores.depth_error == pytest.approx((0.11 + 0.11 + 0.09) / 20)
    assert scores.depth_error_relative == pytest.approx((0.11 + 0.11 + 0.09) / 20 / SIZE)


def test_depth_is_not_asked_of_soft_and_empty_pixels(truth):
    alpha, depth = perfect(truth)
    depth[truth.alpha < 1] = 99.0
    assert measure_geometry(alpha, depth, truth).hole_rate == 0


def test_solid_pixels_that_miss_the_mesh_count_by_opacity_only(truth):
    true_depth = truth.depth.copy()
    true_depth[3, 3:5] = np.nan
    alpha, depth = perfect(truth)
    alpha[3, 3] = 0.0
    scores = measure_geometry(
        alpha, depth, TrueGeometry(alpha=truth.alpha, depth=true_depth, object_size=SIZE)
    )
    assert scores.hole_rate == pytest.approx(1 / 20)
    assert scores.depth_error == 0


def test_spill_counts_empty_pixels_only(truth):
    alpha, depth = perfect(truth)
    alpha[0, :4] = 0.5
    alpha[2:8, 2:9] = 1.0
    scores = measure_geometry(alpha, depth, truth)
    assert scores.spill == pytest.approx(4 / 58)
    assert scores.spill_to_object == pytest.approx(4 / 20)


def test_nothing_there():
    nothing = TrueGeometry(alpha=torch.zeros(3, 3), depth=torch.zeros(3, 3), object_size=SIZE)
    scores = measure_geometry(torch.zeros(3, 3), torch.full((3, 3), math.nan), nothing)
    assert scores.hole_rate is None
    assert scores.depth_error is None
    assert scores.depth_error_relative is None
    assert scores.spill_to_object is None
    assert scores.spill == 0
    assert scores.row()["empty_pixels"] == 9


def test_an_empty_prediction_is_all_holes(truth):
    scores = measure_geometry(np.zeros((10, 10)), np.full((10, 10), np.nan), truth)
    assert scores.hole_rate == 1
    assert scores.depth_error is None


def test_bad_input(truth):
    alpha, depth = perfect(truth)
    with pytest.raises(InputError, match="predicted_depth 9 x 10, true_alpha 10 x 10"):
        measure_geometry(alpha, depth[:, :9], truth)
    with pytest.raises(InputError, match=r"predicted alpha: expected shape \(H, W\)"):
        measure_geometry(alpha[..., None], depth, truth)
    depth[4, 4] = np.nan
    with pytest.raises(InputError, match=r"predicted depth: expected finite.* at 1 pixels"):
        measure_geometry(alpha, depth, truth)
    alpha[0, 0] = np.nan
    with pytest.raises(InputError, match="predicted alpha: expected finite numbers"):
        measure_geometry(alpha, depth, truth)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_an_object_needs_a_size(truth, size):
    wrong = TrueGeometry(alpha=truth.alpha, depth=truth.depth, object_size=size)
    with pytest.raises(InputError, match="expected the object's size as a positive length"):
        measure_geometry(*perfect(truth), wrong)

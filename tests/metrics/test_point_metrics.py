"""Chamfer distance, earth mover's distance and F-score against SciPy and by hand."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.distance import cdist

from pcore.errors import InputError
from pcore.metrics.point_metrics import (
    compare_clouds,
    earth_movers_distance,
    f_score,
    nearest_distances,
    unit_cube,
)

RANDOM = np.random.default_rng(0)


def test_by_hand() -> None:
    """Truth: the ends of a segment of length 2. Predicted: one end, off by 0.015, and the other."""
    truth = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    scores = compare_clouds(np.array([[0.0, 0.015, 0.0], [2.0, 0.0, 0.0]]), truth)
    assert scores.chamfer == pytest.approx(0.015 / 2 + 0.015 / 2)
    assert scores.emd == pytest.approx(0.015 / 2)
    assert scores.f_01 == pytest.approx(0.5)
    assert scores.f_02 == pytest.approx(1.0)
    assert scores.row() == {
        "chamfer": scores.chamfer,
        "emd": scores.emd,
        "f_01": scores.f_01,
        "f_02": scores.f_02,
    }


def test_chamfer_and_f_score_agree_with_all_distances() -> None:
    predicted, truth = RANDOM.normal(size=(400, 3)), RANDOM.normal(size=(500, 3))
    low, high = truth.min(axis=0), truth.max(axis=0)
    half = (high - low).max() / 2
    pairs = cdist((predicted - (low + high) / 2) / half, (truth - (low + high) / 2) / half)
    scores = compare_clouds(predicted, truth, emd_points=50)
    assert scores.chamfer == pytest.approx(pairs.min(axis=1).mean() + pairs.min(axis=0).mean())
    for threshold, value in ((0.01, scores.f_01), (0.02, scores.f_02), (0.2, None)):
        precision = (pairs.min(axis=1) <= threshold).mean()
        recall = (pairs.min(axis=0) <= threshold).mean()
        expected = 0.0 if precision + recall == 0 else 2 / (1 / precision + 1 / recall)
        if value is None:
            value = f_score(pairs.min(axis=1), pairs.min(axis=0), threshold)
            assert value > 0.5
        assert value == pytest.approx(expected)


def test_the_earth_movers_distance_is_the_best_of_all_matchings() -> None:
    first, second = RANDOM.normal(size=(2, 6, 3))
    pairs = cdist(first, second)
    best = min(pairs[range(6), order].mean() for order in itertools.permutations(range(6)))
    assert earth_movers_distance(first, second) == pytest.approx(best)


def test_the_earth_movers_distance_is_the_optimum_of_its_linear_program() -> None:
    """The transport problem itself, without assuming that its optimum is a matching."""
    count = 12
    first, second = RANDOM.normal(size=(2, count, 3))
    supply = np.kron(np.eye(count), np.ones(count))
    demand = np.kron(np.ones(count), np.eye(count))
    solved = linprog(
        cdist(first, second).ravel(),
        A_eq=np.concatenate([supply, demand]),
        b_eq=np.full(2 * count, 1 / count),
    )
    assert earth_movers_distance(first, second) == pytest.approx(solved.fun)


def test_a_shift_costs_its_length() -> None:
    cloud = RANDOM.uniform(-1, 1, size=(300, 3))
    assert earth_movers_distance(cloud, cloud + np.array([0.003, 0.0, 0.0])) == pytest.approx(0.003)


def test_identical_clouds() -> None:
    cloud = RANDOM.normal(size=(64, 3))
    scores = compare_clouds(cloud, cloud)
    assert (scores.chamfer, scores.emd, scores.f_01, scores.f_02) == (0.0, 0.0, 1.0, 1.0)


def test_units_do_not_matter() -> None:
    predicted, truth = RANDOM.normal(size=(2, 200, 3))
    here = compare_clouds(predicted, truth)
    there = compare_clouds(7.0 * predicted + 3.0, 7.0 * truth + 3.0)
    for name, value in here.row().items():
        assert there.row()[name] == pytest.approx(value)
    center, half = unit_cube(truth)
    assert np.abs((truth - center) / half).max() == pytest.approx(1.0)


def test_nothing_found() -> None:
    far = np.array([[9.0, 0.0, 0.0]])
    near = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert f_score(nearest_distances(far, near), nearest_distances(near, far), 0.01) == 0.0


def test_bad_input() -> None:
    cloud = RANDOM.normal(size=(5, 3))
    with pytest.raises(InputError, match=r"predicted cloud: expected points \(N, 3\), got shape"):
        compare_clouds(np.zeros((0, 3)), cloud)
    with pytest.raises(InputError, match="truth cloud: expected finite points"):
        compare_clouds(cloud, cloud * math.nan)
    with pytest.raises(InputError, match="got all in one place"):
        compare_clouds(cloud, np.zeros((4, 3)))
    with pytest.raises(InputError, match="expected equally many points, got 5 and 4"):
        earth_movers_distance(cloud, cloud[:4])

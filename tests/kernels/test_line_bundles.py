"""The tube around a bundle of lines holds them all, and splitting keeps them all."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pcore.kernels import line_bundles

BOX = np.array([[-1.0, -0.5, -0.8], [0.6, 0.9, 1.0]], dtype=np.float32)


def lines(count: int, angle: float, spread: float) -> tuple[np.ndarray, np.ndarray]:
    origins = torch.randn(count, 3) * spread + torch.tensor([0.0, 3.0, 1.0])
    directions = torch.tensor([0.1, -1.0, -0.3]) + angle * torch.randn(count, 3)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    return origins.numpy(), directions.numpy()


@pytest.mark.parametrize(("angle", "spread"), [(0.01, 0.0), (0.05, 0.1), (0.2, 0.5), (0.0, 0.3)])
def test_bounds_hold_for_every_line_and_point(angle: float, spread: float) -> None:
    origins, directions = lines(50, angle, spread)
    bundle, centre, radius, _ = line_bundles.as_lines(origins, directions, BOX)
    tube = line_bundles.enclose(bundle, centre, radius)
    foot, axis = tube.foot.astype(np.float64), tube.axis.astype(np.float64)
    points = BOX[0] + np.random.default_rng(0).random((500, 3)) * (BOX[1] - BOX[0])
    offset = points - foot
    z = offset @ axis
    h = np.linalg.norm(offset - z[:, None] * axis, axis=-1)
    r = np.maximum(tube.base + tube.slope * z, tube.base_after + tube.slope_after * z)
    v = points[None] - origins[:, None].astype(np.float64)
    distance = np.linalg.norm(np.cross(v, directions[:, None].astype(np.float64)), axis=-1)
    assert (distance <= h + r + 1e-5).all()
    assert (distance >= (h - r) * tube.cosine - 1e-5).all()
    if spread == 0.0:  # The lines meet in one point: some of them lie on the cone.
        assert (distance.max(axis=0) / (h + r)).max() > 0.95, "the bounds are tight"


def test_lines_in_all_directions_have_no_bounds() -> None:
    directions = torch.nn.functional.normalize(torch.randn(40, 3), dim=-1).numpy()
    bundle, centre, radius, _ = line_bundles.as_lines(np.zeros_like(directions), directions, BOX)
    assert line_bundles.enclose(bundle, centre, radius).cosine == 0


def test_splitting_keeps_lines_and_their_order_together() -> None:
    origins, directions = lines(333, 0.1, 0.2)
    bundle, _, radius, _ = line_bundles.as_lines(origins, directions, BOX)
    before, order = bundle.copy(), np.arange(333)
    borders = line_bundles.cut(bundle, order, radius, 8)
    assert borders[0] == 0
    assert borders[-1] == 333
    assert (np.diff(borders) > 0).all()
    assert len(borders) > 8
    assert sorted(order.tolist()) == list(range(333))
    np.testing.assert_array_equal(bundle, before[order])


def test_equal_lines_can_be_cut() -> None:
    directions = np.tile(np.array([[0.0, 0.0, 1.0]], dtype=np.float32), (100, 1))
    bundle, _, radius, _ = line_bundles.as_lines(np.ones_like(directions), directions, BOX)
    borders = line_bundles.cut(bundle, np.arange(100), radius, 4)
    assert (np.diff(borders) > 0).all()


@pytest.mark.parametrize("number", [np.nan, np.inf, 1e20])
def test_no_bounds_where_numbers_would_overflow(number: float) -> None:
    origins, directions = lines(20, 0.1, 0.1)
    origins[3, 1] = number
    assert line_bundles.as_lines(origins, directions, BOX)[3] == np.inf

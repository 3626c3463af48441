"""SC-GS's rule: what it keeps, and where it must tear."""

from __future__ import annotations

import math

import torch
from tests.render.test_gaussian_surfels import a_ball

from pcore.gaussians.covariance import covariances, rotations
from pcore.gaussians.gaussians import Gaussians
from pcore.rivals.nodes import carried_by_nodes, node_rig


def turned(points: torch.Tensor) -> torch.Tensor:
    c, s = math.cos(0.7), math.sin(0.7)
    return points @ torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]]).to(points).T + 0.5


def shape(gaussians: Gaussians) -> torch.Tensor:
    return covariances(gaussians.quats, gaussians.scales)


def test_nodes_that_stay_move_nothing() -> None:
    ball = a_ball()
    rig = node_rig(ball, count=40)
    still = carried_by_nodes(ball, rig, rig.nodes).gaussians
    torch.testing.assert_close(still.means, ball.means, atol=1e-5, rtol=0)
    torch.testing.assert_close(shape(still), shape(ball), atol=1e-6, rtol=1e-3)


def test_a_rigid_motion_is_followed_exactly() -> None:
    ball = a_ball()
    rig = node_rig(ball, count=40)
    moved = carried_by_nodes(ball, rig, turned(rig.nodes)).gaussians
    torch.testing.assert_close(moved.means, turned(ball.means), atol=1e-4, rtol=0)
    turn = rotations(moved.quats) @ rotations(ball.quats).mT
    expected = turned(torch.eye(3)).T - turned(torch.zeros(3, 3)).T
    torch.testing.assert_close(turn, expected.expand_as(turn), atol=1e-4, rtol=0)
    # As published, what is seen of a Gaussian does not turn with it.
    assert torch.equal(moved.sh, ball.sh)


def test_it_cannot_scale() -> None:
    ball = a_ball()
    rig = node_rig(ball, count=40)
    grown = carried_by_nodes(ball, rig, 2 * rig.nodes).gaussians
    assert torch.equal(grown.scales, ball.scales)
    # Cells stay as they are around nodes that went apart: means are off by up to a cell.
    off = (grown.means - 2 * ball.means).norm(dim=1)
    assert float(off.max()) > 0.05


def test_weights_are_shares_of_few_nodes() -> None:
    rig = node_rig(a_ball(), count=40)
    assert len(rig.nodes) == 40
    assert rig.weights.shape[1] == 8
    torch.testing.assert_close(rig.weights.sum(dim=1), torch.ones(len(rig.weights)).double())

"""Rotations by projection and by Procrustes."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from pcore.geometry.rotation import nearest_rotation, procrustes


def rotations(count: int) -> torch.Tensor:
    return torch.from_numpy(Rotation.random(count, rng=0).as_matrix())


def test_a_rotation_is_its_own_projection() -> None:
    turn = rotations(20)
    torch.testing.assert_close(nearest_rotation(turn), turn)
    torch.testing.assert_close(nearest_rotation(3.0 * turn.float()), turn.float())


def test_the_projection_is_proper_and_no_rotation_is_nearer() -> None:
    matrices = torch.randn(30, 3, 3, dtype=torch.float64)
    found = nearest_rotation(matrices)
    assert (torch.det(matrices) < 0).any()
    torch.testing.assert_close(torch.det(found), torch.ones(30, dtype=torch.float64))
    torch.testing.assert_close(
        found @ found.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand(30, 3, 3)
    )
    distance = (matrices - found).square().sum(dim=(1, 2))
    others = (matrices[:, None] - rotations(500)).square().sum(dim=(2, 3))
    assert (others >= distance[:, None]).all()


@pytest.mark.parametrize("spans", [1, 2, 3])
def test_procrustes_recovers_the_turn_of_what_is_there(spans: int) -> None:
    turn = rotations(10)
    before = torch.randn(10, 6, 3, dtype=torch.float64)
    before[..., spans:] = 0
    after = before @ turn.transpose(1, 2)
    found = procrustes(before, after, torch.rand(10, 6, dtype=torch.float64) + 0.1)
    torch.testing.assert_close(before @ found.transpose(1, 2), after, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(torch.det(found), torch.ones(10, dtype=torch.float64))


def test_procrustes_listens_to_the_weights() -> None:
    before = torch.eye(3, dtype=torch.float64).repeat(2, 1)
    turn, other = rotations(2)
    after = torch.cat([before[:3] @ turn.T, before[3:] @ other.T])
    weights = torch.tensor([1.0, 1, 1, 0, 0, 0], dtype=torch.float64)
    torch.testing.assert_close(procrustes(before, after, weights), turn, atol=1e-6, rtol=1e-6)


def test_scipy_agrees() -> None:
    before, after = torch.randn(2, 9, 3, dtype=torch.float64)
    weights = torch.rand(9, dtype=torch.float64)
    expected, _ = Rotation.align_vectors(after.numpy(), before.numpy(), weights.numpy())
    torch.testing.assert_close(
        procrustes(before, after, weights),
        torch.from_numpy(expected.as_matrix()),
        atol=1e-7,
        rtol=0,
    )

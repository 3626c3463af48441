import pytest
import torch
from tests.gaussians.some import some_gaussians
from torch.nn.functional import normalize

from pcore.gaussians.covariance import covariances, quaternions
from pcore.geometry.rotation import rotations


def test_rotations_are_proper_and_found_again():
    quats = some_gaussians(500, dtype=torch.float64).quats
    matrices = rotations(quats)
    torch.testing.assert_close(torch.linalg.det(matrices), torch.ones(500, dtype=torch.float64))
    torch.testing.assert_close(quaternions(matrices), quats * quats[:, :1].sign())


@pytest.mark.parametrize("axis", range(4))
def test_half_turns_are_found_again(axis):
    quat = torch.eye(4, dtype=torch.float64)[axis]
    matrix = rotations(quat)
    torch.testing.assert_close(rotations(quaternions(matrix)), matrix)


def test_a_quarter_turn_about_z_takes_x_to_y():
    quat = normalize(torch.tensor([1.0, 0.0, 0.0, 1.0]), dim=0)
    torch.testing.assert_close(
        rotations(quat) @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0])
    )


def test_gradients_pass_through_covariances():
    gaussians = some_gaussians(4, dtype=torch.float64)
    quats, scales = gaussians.quats.requires_grad_(), gaussians.scales.requires_grad_()
    assert torch.autograd.gradcheck(covariances, (quats, scales))

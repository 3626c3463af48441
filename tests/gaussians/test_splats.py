"""Splats that are carried along are the Gaussians that the renderer draws."""

import math

import pytest
import torch
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.gaussians.carry import polar
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import pose
from pcore.gaussians.spherical_harmonics import colors, rotated
from pcore.gaussians.splats import SplatsAtRest

EYE = torch.tensor([0.3, -2.0, 1.0])


def some(degree: int = 3, count: int = 50) -> Gaussians:
    draw = torch.Generator().manual_seed(degree)
    return Gaussians(
        means=0.3 * torch.randn(count, 3, generator=draw),
        quats=F.normalize(torch.randn(count, 4, generator=draw), dim=-1),
        scales=0.02 + 0.1 * torch.rand(count, 3, generator=draw),
        opacities=torch.rand(count, generator=draw),
        sh=0.2 * torch.randn(count, (degree + 1) ** 2, 3, generator=draw),
    )


def maps(count: int = 50) -> torch.Tensor:
    draw = torch.Generator().manual_seed(9)
    found = torch.eye(3) + 0.7 * torch.randn(count, 3, 3, generator=draw)
    found[0] = torch.eye(3)
    found[1] = -torch.eye(3)  # Mirrors.
    found[2] = 1e-4 * found[2]
    return found.double()


@pytest.mark.parametrize("degree", [0, 3])
def test_splats_are_what_is_drawn(degree: int):
    gaussians, local, gains = some(degree), maps(), torch.linspace(0.5, 1.5, 50)
    positions = gaussians.means + 0.1
    drawn = pose(gaussians, positions, local.float(), gains.unsqueeze(1))
    seen = F.normalize(positions - EYE, dim=1)
    turned = rotated(gaussians.sh, polar(local)) if degree else gaussians.sh
    expected = colors(turned, seen) * gains.unsqueeze(1)
    torch.testing.assert_close(drawn.colors(seen), expected, rtol=0, atol=1e-5)
    found = SplatsAtRest.of(gaussians).moved(positions, local, EYE, gains)
    assert all(
        part.dtype == "float32"
        for part in (found.centers, found.covariances, found.rgb, found.opacities)
    )
    torch.testing.assert_close(torch.from_numpy(found.centers), positions)
    torch.testing.assert_close(
        torch.from_numpy(found.covariances), drawn.covariances, rtol=1e-4, atol=1e-6
    )
    torch.testing.assert_close(torch.from_numpy(found.rgb), expected.clamp(0, 1), rtol=0, atol=2e-5)


def test_a_map_that_flattens_everything_leaves_finite_splats():
    gaussians, local = some(), torch.zeros(50, 3, 3, dtype=torch.float64)
    local[1, 0, 0] = 1.0
    found = SplatsAtRest.of(gaussians).moved(gaussians.means, local, EYE)
    assert torch.from_numpy(found.rgb).isfinite().all()
    assert torch.from_numpy(found.covariances).isfinite().all()


def test_splats_beside_their_points_turn_about_them():
    gaussians, angle = some(0), math.pi / 2
    points = gaussians.means - torch.tensor([0.1, 0.0, 0.0])
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert math.isclose(math.sin(angle), 1.0)
    found = SplatsAtRest.of(gaussians, points).moved(
        points @ turn.T, turn.double().expand(50, 3, 3), EYE
    )
    torch.testing.assert_close(torch.from_numpy(found.centers), gaussians.means @ turn.T)


def test_of_other_points_it_says_so():
    with pytest.raises(InputError, match=r"expected positions \(50, 3\) and an eye \(3,\), got"):
        SplatsAtRest.of(some()).moved(torch.zeros(3, 3), None, EYE)

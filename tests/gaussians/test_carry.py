from dataclasses import replace

import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.errors import EditError
from pcore.gaussians.carry import carried, carried_axes, polar
from pcore.gaussians.covariance import covariances
from pcore.gaussians.spherical_harmonics import basis


def maps_of(count, seed=1):
    source = torch.Generator().manual_seed(seed)
    return torch.randn(count, 3, 3, generator=source, dtype=torch.float64)


def test_covariances_become_j_s_jt():
    gaussians, maps = some_gaussians(400), maps_of(400)
    moved = carried(gaussians, gaussians.means + 1, maps)
    expected = maps @ covariances(gaussians.quats.double(), gaussians.scales.double()) @ maps.mT
    found = covariances(moved.quats.double(), moved.scales.double())
    error = (found - expected).norm(dim=(1, 2)) / expected.norm(dim=(1, 2))
    assert float(error.max()) < 1e-6
    torch.testing.assert_close(moved.means, gaussians.means + 1)
    assert torch.equal(moved.opacities, gaussians.opacities)


def test_needles_keep_the_digits_of_their_short_axes():
    gaussians = some_gaussians(100, dtype=torch.float64)
    thin = gaussians.scales * torch.tensor([1.0, 1e-3, 1e-5], dtype=torch.float64)
    gaussians, maps = replace(gaussians, scales=thin), maps_of(100)
    moved = carried(gaussians, gaussians.means, maps)
    # The volume says whether the smallest scale has its digits.
    expected = thin.prod(dim=1) * torch.linalg.det(maps).abs()
    torch.testing.assert_close(moved.scales.prod(dim=1), expected, rtol=1e-9, atol=0)


def test_colours_turn_with_the_polar_rotation():
    gaussians, maps = some_gaussians(300, dtype=torch.float64), maps_of(300)
    moved = carried(gaussians, gaussians.means, maps)
    left, _, right = torch.linalg.svd(maps)
    turn = left @ right
    seen = torch.nn.functional.normalize(torch.randn(300, 3, dtype=torch.float64), dim=1)
    before = (basis(3, seen)[..., None] * gaussians.sh).sum(dim=1)
    after = (basis(3, (turn @ seen[..., None]).squeeze(-1))[..., None] * moved.sh).sum(dim=1)
    torch.testing.assert_close(after, before, atol=1e-10, rtol=0)


def test_the_identity_changes_nothing_but_last_bits():
    gaussians = some_gaussians(50)
    moved = carried(gaussians, gaussians.means, torch.eye(3).expand(50, 3, 3))
    sign = gaussians.quats[:, :1].sign()
    torch.testing.assert_close(moved.quats, gaussians.quats * sign, atol=3e-7, rtol=0)
    torch.testing.assert_close(moved.scales, gaussians.scales, atol=0, rtol=3e-7)
    torch.testing.assert_close(moved.sh, gaussians.sh, atol=1e-6, rtol=0)


@pytest.mark.parametrize("kept", [0, 1, 2, 3])
def test_polar_factors_of_singular_maps_are_orthogonal(kept):
    maps = maps_of(20)
    left, sizes, right = torch.linalg.svd(maps)
    sizes[:, kept:] = 0
    factor = polar(left * sizes[:, None] @ right)
    eye = torch.eye(3, dtype=torch.float64).expand(20, 3, 3)
    torch.testing.assert_close(factor @ factor.mT, eye, atol=1e-12, rtol=0)


def test_a_map_that_flattens_leaves_a_gaussian_that_is_one():
    gaussians = some_gaussians(5)
    flat = torch.diag(torch.tensor([1.0, 1.0, 0.0])).expand(5, 3, 3)
    moved = carried(gaussians, gaussians.means, flat).checked("moved")
    assert float((moved.scales.amin(dim=1) / moved.scales.amax(dim=1)).max()) < 1e-8


@pytest.mark.parametrize("value", [torch.nan, torch.inf, 0.0])
def test_maps_that_lead_nowhere_are_refused(value):
    gaussians = some_gaussians(5)
    maps = torch.eye(3).repeat(5, 1, 1)
    maps[2] = value
    with pytest.raises(EditError, match="of 5 Gaussians"):
        carried(gaussians, gaussians.means, maps)


def test_another_number_of_maps_is_refused():
    gaussians = some_gaussians(5)
    with pytest.raises(EditError, match="expected positions"):
        carried(gaussians, gaussians.means, torch.eye(3).expand(4, 3, 3))


def test_axes_are_differentiable_in_the_maps():
    gaussians, maps = some_gaussians(3, dtype=torch.float64), maps_of(3).requires_grad_()
    assert torch.autograd.gradcheck(lambda m: carried_axes(gaussians, m), (maps,))

import math

import pytest
import torch
from numpy.polynomial.legendre import leggauss
from torch.nn.functional import normalize

from pcore.gaussians.carry import polar
from pcore.gaussians.seen_colors import seen_colors
from pcore.gaussians.spherical_harmonics import HIGHEST_DEGREE, basis, brightened, colors, rotated


def directions(count=200, seed=0):
    source = torch.Generator().manual_seed(seed)
    return normalize(torch.randn(count, 3, generator=source, dtype=torch.float64), dim=1)


def test_the_basis_is_orthonormal_on_the_sphere():
    heights, weights = (torch.from_numpy(a) for a in leggauss(8))
    angles = torch.arange(16, dtype=torch.float64) * math.tau / 16
    z, angle = torch.meshgrid(heights, angles, indexing="ij")
    ring = (1 - z * z).sqrt()
    places = torch.stack([ring * angle.cos(), ring * angle.sin(), z], dim=-1)
    values = basis(HIGHEST_DEGREE, places)
    gram = torch.einsum("h,hak,hal->kl", weights, values, values) * math.tau / 16
    torch.testing.assert_close(gram, torch.eye(25, dtype=torch.float64), atol=1e-12, rtol=0)


def test_the_basis_is_that_of_gaussian_splatting():
    """Its published constants, for the first of every degree and some with other signs."""
    d = directions()
    x, y, z = d.unbind(dim=1)
    found = basis(4, d)
    expected = {
        0: torch.full_like(x, 0.28209479177387814),
        1: -0.4886025119029199 * y,
        2: 0.4886025119029199 * z,
        3: -0.4886025119029199 * x,
        4: 1.0925484305920792 * x * y,
        5: -1.0925484305920792 * y * z,
        6: 0.31539156525252005 * (2 * z * z - x * x - y * y),
        8: 0.5462742152960396 * (x * x - y * y),
        9: -0.5900435899266435 * y * (3 * x * x - y * y),
        10: 2.890611442640554 * x * y * z,
        13: -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        15: -0.5900435899266435 * x * (x * x - 3 * y * y),
        16: 2.5033429417967046 * x * y * (x * x - y * y),
        20: 0.10578554691520431 * (z * z * (35 * z * z - 30) + 3),
    }
    for index, values in expected.items():
        torch.testing.assert_close(found[:, index], values, atol=1e-13, rtol=0)


@pytest.mark.parametrize("degree", range(HIGHEST_DEGREE + 1))
def test_what_was_seen_along_a_direction_is_seen_along_the_turned_one(degree):
    source = torch.Generator().manual_seed(degree)
    sh = torch.randn(50, (degree + 1) ** 2, 3, generator=source, dtype=torch.float64)
    turns = polar(torch.randn(50, 3, 3, generator=source, dtype=torch.float64))
    assert (torch.linalg.det(turns) < 0).any()  # Mirrors are among them.
    d = directions(50)
    turned = (turns @ d[:, :, None]).squeeze(-1)
    torch.testing.assert_close(
        colors(rotated(sh, turns), turned), colors(sh, d), atol=1e-12, rtol=0
    )


def test_colours_begin_at_a_half_and_are_not_negative():
    sh = torch.zeros(2, 1, 3)
    sh[1] = -10.0
    assert colors(sh, directions(2).float()).tolist() == [[0.5] * 3, [0.0] * 3]


def test_gradients_reach_coefficients_and_directions():
    sh = torch.randn(4, 9, 3, dtype=torch.float64, requires_grad=True)
    d = directions(4).requires_grad_()
    assert torch.autograd.gradcheck(lambda s, v: colors(s + 1, v), (sh, d))


@pytest.mark.parametrize("degree", range(HIGHEST_DEGREE + 1))
def test_the_loops_say_what_the_basis_says(degree: int) -> None:
    """Three directions of each of 600, several chunks: colours, gradients, sums over directions."""
    source = torch.Generator().manual_seed(degree)
    sh = torch.randn(600, (degree + 1) ** 2, 3, generator=source, dtype=torch.float64)
    seen = directions(1800).view(3, 600, 3)
    weights = torch.randn(3, 600, 3, generator=source, dtype=torch.float64)
    results = []
    for by_loops in (True, False):
        own, along = sh.clone().requires_grad_(), seen.clone().requires_grad_()
        if by_loops:
            rgb = colors(own, along)
        else:
            values = basis(degree, along) + 0 * along.sum()
            rgb = (0.5 + torch.einsum("cnk,nkd->cnd", values, own)).clamp_min(0.0)
        (rgb * weights).sum().backward()
        results.append((rgb.detach(), own.grad, along.grad))
    assert float(results[0][0].min()) == 0.0 < float(results[0][1].abs().max())
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("degree", range(HIGHEST_DEGREE + 1))
def test_factors_on_coefficients_are_factors_on_colours(degree):
    source = torch.Generator().manual_seed(degree)
    sh = torch.randn(50, (degree + 1) ** 2, 3, generator=source, dtype=torch.float64)
    factors = 3 * torch.rand(50, generator=source, dtype=torch.float64)
    seen = colors(sh, directions(50))
    assert (seen == 0).any()  # Dark ones stay dark.
    found = colors(brightened(sh, factors), directions(50))
    torch.testing.assert_close(found, seen * factors[:, None], atol=1e-14, rtol=1e-12)


@pytest.mark.parametrize("degree", range(HIGHEST_DEGREE + 1))
def test_the_colours_are_those_of_gsplat(degree):
    """Its own reference in torch; the pieces that are compiled for a GPU are not asked."""
    reference = pytest.importorskip("gsplat.cuda._torch_impl")
    source = torch.Generator().manual_seed(degree)
    sh = torch.randn(50, (degree + 1) ** 2, 3, generator=source, dtype=torch.float64)
    expected = reference._spherical_harmonics(degree, directions(50), sh)
    torch.testing.assert_close(
        colors(sh, directions(50)), (0.5 + expected).clamp_min(0), atol=1e-6, rtol=1e-6
    )


@pytest.mark.parametrize("degree", range(HIGHEST_DEGREE + 1))
def test_colours_of_a_page_are_those_of_pictures(degree: int):
    source = torch.Generator().manual_seed(1)
    sh = torch.randn(200, (degree + 1) ** 2, 3, generator=source)
    seen = directions().float()
    torch.testing.assert_close(seen_colors(sh, seen), colors(sh, seen), rtol=0, atol=1e-5)

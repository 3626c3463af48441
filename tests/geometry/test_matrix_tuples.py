import torch

from pcore.deform.base import matrix_product, uprightness
from pcore.geometry.matrix_tuples import extents, polar_factors


def matrices(count: int = 130) -> torch.Tensor:
    source = torch.Generator().manual_seed(0)
    return torch.randn(count, 3, 3, generator=source, dtype=torch.float64)


def test_products_have_the_bits_of_those_that_take_gradients():
    left, right = matrices(), matrices().flip(0)
    for one, other in (
        (left, right),
        (left[0], right),
        (left[0].T, right.mT.unflatten(0, (2, -1))),
    ):
        followed = matrix_product(one.clone().requires_grad_(), other)
        assert torch.equal(matrix_product(one, other), followed)
        torch.testing.assert_close(followed, one @ other)


def test_extents_are_singular_values_of_whatever_condition():
    given, unit = matrices(), torch.eye(3, dtype=torch.float64)
    turn = torch.linalg.qr(given)[0]
    cases = [given, unit + 0.01 * given, unit.expand(2, 3, 3)]
    cases += [turn * torch.tensor([2.0, 1.0, 1.0]), turn * torch.tensor([2.0, 2.0, 1.0])]
    cases += [given * torch.tensor([1e3, 1.0, 1e-3]), 1e-6 * given]
    for one in cases:
        found = torch.from_numpy(extents(one.contiguous().numpy()))
        torch.testing.assert_close(found, torch.linalg.svdvals(one), rtol=1e-7, atol=0)
    flat = given.clone()
    flat[:, 2], flat[0], flat[1, 1] = 0.0, 0.0, flat[1, 0]
    found = torch.from_numpy(extents(flat.numpy()))
    torch.testing.assert_close(found, torch.linalg.svdvals(flat), rtol=1e-7, atol=1e-7)


def test_polar_factors_are_those_by_singular_values_in_every_unit():
    given = matrices()
    left, _, right = torch.linalg.svd(given)
    for unit in (1.0, 1e-6, 1e6):
        found = torch.from_numpy(polar_factors((unit * given).reshape(-1, 9).numpy()))
        torch.testing.assert_close(found.reshape(-1, 3, 3), left @ right, rtol=0, atol=1e-5)


def test_a_singular_matrix_has_the_identity_and_disturbs_none_beside_it():
    given = matrices(3).reshape(-1, 9)
    given[1] = torch.arange(9.0)
    alone, found = polar_factors(given[:1].numpy()), polar_factors(given.numpy())
    assert torch.equal(torch.from_numpy(found[1]).reshape(3, 3), torch.eye(3).double())
    torch.testing.assert_close(torch.from_numpy(found[0]), torch.from_numpy(alone[0]))


def test_uprightness_is_the_same_in_both_precisions_and_of_nothing_it_is_0():
    given = matrices()
    given[0], given[1] = 0.0, torch.nan
    single = uprightness(given.float())
    torch.testing.assert_close(uprightness(given).float(), single, rtol=0, atol=1e-5)
    assert uprightness(given)[:2].tolist() == [0.0, 0.0]
    assert uprightness(given.reshape(2, 65, 3, 3)).shape == (2, 65)

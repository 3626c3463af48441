from dataclasses import replace

import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians


def test_degree_and_length_follow_from_the_tensors():
    gaussians = some_gaussians(7, degree=2)
    assert (len(gaussians), gaussians.degree) == (7, 2)


@pytest.mark.parametrize("shape", [(7, 5, 3), (7, 36, 3), (7, 4), (6, 4, 3)])
def test_harmonics_that_fit_no_degree_or_no_number_are_refused(shape):
    with pytest.raises(InputError, match="gaussians: expected"):
        replace(some_gaussians(7), sh=torch.zeros(shape))


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "sh"])
def test_values_that_are_not_finite_are_named(field):
    gaussians = some_gaussians(7)
    broken = getattr(gaussians, field).clone()
    broken[2] = torch.nan
    with pytest.raises(InputError, match=rf"a\.ply: expected finite {field}, .* 1 of 7"):
        replace(gaussians, **{field: broken}).checked("a.ply")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"quats": torch.ones(7, 4)}, "unit length"),
        ({"scales": torch.zeros(7, 3)}, "greater than 0"),
        ({"opacities": torch.full((7,), 2.0)}, "from 0 to 1"),
        ({"opacities": torch.zeros(7)}, "opacity 0 in all 7"),
    ],
)
def test_values_outside_their_range_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(some_gaussians(7), **change).checked("a.ply")


def test_good_values_pass_and_none_at_all_are_refused():
    gaussians = some_gaussians(7)
    assert gaussians.checked("a.ply") is gaussians
    with pytest.raises(InputError, match="at least one"):
        gaussians.each(lambda tensor: tensor[:0]).checked("a.ply")


def test_to_and_detached_reach_every_tensor():
    gaussians = some_gaussians(3).each(lambda tensor: tensor.requires_grad_())
    other = gaussians.to(dtype=torch.float64).detached()
    assert isinstance(other, Gaussians)
    assert {t.dtype for t in vars(other).values()} == {torch.float64}
    assert not any(t.requires_grad for t in vars(other).values())

import math

import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.deform.base import Affine, Deformation
from pcore.editing.script import parse_edit
from pcore.errors import InputError
from pcore.gaussians.carry import deformed
from pcore.gaussians.covariance import covariances
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.refine import bending, refined


def bend(degrees: float) -> Deformation:
    """Bend what reaches from z = -1 to 1 about x."""
    body = torch.tensor([[0.0, 0, -1], [0, 0, 1], [0.1, 0.1, 0]])
    return parse_edit(
        {"version": 2, "edits": [{"type": "bend", "axis": "x", "angle_deg": degrees}]}
    ).bind(body)


def needle(opacity: float = 0.9, *, long: float = 0.4, thin: float = 0.01) -> Gaussians:
    return Gaussians(
        means=torch.zeros(1, 3, dtype=torch.float64),
        quats=torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64),
        scales=torch.tensor([[thin, thin, long]], dtype=torch.float64),
        opacities=torch.tensor([opacity], dtype=torch.float64),
        sh=torch.zeros(1, 4, 3),
    )


def exponents(gaussians: Gaussians, places: torch.Tensor) -> torch.Tensor:
    """Mahalanobis distances (P, N) of places from Gaussians."""
    inverse = torch.linalg.inv(covariances(gaussians.quats, gaussians.scales))
    offset = places[:, None] - gaussians.means
    return torch.einsum("pni,nij,pnj->pn", offset, inverse, offset).sqrt()


def cover(gaussians: Gaussians, places: torch.Tensor) -> torch.Tensor:
    """What Gaussians cover at places (P,), seen from across."""
    values = gaussians.opacities * torch.exp(-0.5 * exponents(gaussians, places).square())
    return 1 - (1 - values).prod(dim=1)


def axis_points(reach: float, count: int = 81) -> torch.Tensor:
    z = torch.linspace(-reach, reach, count, dtype=torch.float64)
    return torch.stack([0 * z, 0 * z, z], dim=1)


def test_a_needle_bent_by_90_degrees_follows_the_curve():
    curve = bend(90)
    places = curve(axis_points(0.6))
    stiff = deformed(needle(), curve)
    assert float(exponents(stiff, places).max()) > 4.0  # Straight, it leaves the curve.
    pieces = refined(needle(), curve, 0.3)
    assert 3 < len(pieces.gaussians) < 40
    assert float(exponents(deformed(pieces.gaussians, curve), places).amin(dim=1).max()) < 1.0
    # The bend of a piece is within the tolerance; the whole's was far outside.
    assert float(bending(needle(), curve).max()) > 1.0
    assert float(bending(pieces.gaussians, curve).max()) <= 0.3


@pytest.mark.parametrize("opacity", [0.05, 0.5, 0.95])
def test_pieces_look_like_the_whole_from_across(opacity: float):
    pieces = refined(needle(opacity), bend(90), 0.3).gaussians
    places = axis_points(1.0)
    error = (cover(pieces, places) - cover(needle(opacity), places)).abs().max()
    assert float(error) < 0.12 * opacity


def test_an_affine_map_splits_nothing():
    gaussians = some_gaussians(50, dtype=torch.float64)
    matrix = torch.tensor([[2.0, 0.3, 0], [0, 0.5, 0.1], [0.4, 0, 1]])
    result = refined(gaussians, Affine(matrix, torch.zeros(3)), 1e-3)
    assert torch.equal(result.gaussians.means, gaussians.means)
    assert result.origins.tolist() == list(range(50))


def test_only_those_that_bend_are_split_and_others_stay_as_they_are():
    small, large = needle(long=0.011), needle(long=0.5)
    both = Gaussians(**{k: torch.cat([v, vars(large)[k], v]) for k, v in vars(small).items()})
    result = refined(both, bend(90), 0.3)
    assert result.origins[0] == 0
    assert result.origins[-1] == 2
    assert (result.origins == 1).sum() == len(result.gaussians) - 2 > 2
    assert torch.equal(result.gaussians.scales[0], small.scales[0])


def test_sheets_are_split_along_both_axes():
    sheet = needle(long=0.5)
    curve = parse_edit({"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 150}]})
    map_ = curve.bind(torch.tensor([[-1.0, -1, -1], [1, 1, 1]]))
    flat = Gaussians(**{**vars(sheet), "scales": torch.tensor([[0.5, 0.01, 0.5]]).double()})
    pieces = refined(flat, map_, 0.3).gaussians
    assert float(pieces.scales[:, 0].min()) < 0.5
    assert float(pieces.scales[:, 2].min()) < 0.5
    assert len(pieces) < 3000


@pytest.mark.parametrize("tolerance", [0.0, -1.0, math.nan])
def test_a_tolerance_is_greater_than_zero(tolerance: float):
    with pytest.raises(InputError, match="tolerance"):
        refined(needle(), bend(10), tolerance)


def test_no_gaussians_stay_none():
    nothing = needle().each(lambda tensor: tensor[:0])
    assert len(refined(nothing, bend(90), 0.3).gaussians) == 0

"""Local maps: by formula, estimated, torn neighbourhoods, bad input."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from pcore.deform.base import Affine, Compose, Deformation
from pcore.deform.frame import axis_frame
from pcore.deform.jacobian import analytic_maps, estimated_maps
from pcore.deform.motion import rigid
from pcore.deform.simple import Stretch, uniform_scale
from pcore.errors import EditError
from pcore.geometry.local_maps import LocalMaps


def sphere(count: int = 600) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(count, 3), dim=-1)


def similarity() -> Deformation:
    turn = rigid((0.3, -1.0, 0.5), 1.1, (0.2, 0.1, -0.4), (0.0, 0.0, 0.0))
    return Compose(uniform_scale(1.7), turn)


def errors(maps: LocalMaps, deformation: Deformation, rest: Tensor) -> Tensor:
    """Frobenius norm (N,) of B A - 1: what a map leaves of the true one, at (N, 3) points."""
    product = maps.to_rest.double() @ deformation.jacobian(rest.double())
    return torch.linalg.matrix_norm(product - torch.eye(3, dtype=torch.float64))


def test_the_formula_gives_the_inverse_jacobian() -> None:
    rest = sphere()
    stretch = Stretch(
        rotation=axis_frame("z"),
        origin=torch.zeros(3),
        extent=(-1.0, 1.0),
        value=0.6,
        limits=(0.0, 1.0),
        lock=(False, False),
    )
    maps = analytic_maps(stretch, rest)
    assert float(errors(maps, stretch, rest).max()) < 1e-5


def test_a_fold_is_refused_with_the_number_of_points() -> None:
    mirror = Affine(torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3))
    with pytest.raises(EditError, match="at 600 of 600 points"):
        analytic_maps(mirror, sphere())


def test_a_similarity_is_estimated_exactly() -> None:
    rest, move = sphere(), similarity()
    maps = estimated_maps(rest, move(rest))
    assert float(errors(maps, move, rest).max()) < 1e-3
    assert len(maps.mended) == 0


def test_an_affine_map_is_estimated_along_the_surface() -> None:
    rest = sphere(3000)
    move = Affine(torch.diag(torch.tensor([1.0, 1.0, 1.6])), torch.zeros(3))
    maps = estimated_maps(rest, move(rest))
    tangent = torch.linalg.cross(rest, torch.nn.functional.normalize(torch.randn(3, 1), dim=0).T)
    tangent = torch.nn.functional.normalize(tangent, dim=-1)
    image = tangent @ torch.diag(torch.tensor([1.0, 1.0, 1.6]))
    back = (maps.to_rest @ image.unsqueeze(-1)).squeeze(-1)
    assert float((back - tangent).norm(dim=-1).quantile(0.95)) < 0.15


def test_a_part_that_leaves_keeps_its_own_map() -> None:
    """Two touching halves turn apart: maps at the seam are those of their own half."""
    rest = torch.rand(2500, 3) * torch.tensor([2.0, 1.0, 0.02]) - torch.tensor([1.0, 0.5, 0.0])
    turn = rigid("z", math.radians(40), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0))
    part = rest[:, 0] > 0
    moved = torch.where(part[:, None], turn(rest), rest)
    maps = estimated_maps(rest, moved)
    seam = rest[:, 0].abs() < 0.05
    still = torch.eye(3, dtype=torch.float64)
    wrong = torch.where(
        part, errors(maps, turn, rest), torch.linalg.matrix_norm(maps.to_rest.double() - still)
    )
    assert int(seam.sum()) > 50
    assert float(wrong[seam].median()) < 0.1
    assert float(wrong[~seam].quantile(0.95)) < 0.05


def test_parts_torn_apart_are_drawn_out_nowhere() -> None:
    """Two halves of a sphere leave one another: no map at the seam spans the gap between them."""
    rest = sphere(4000)
    gone = rigid("z", math.radians(50), (0.0, 0.0, 0.0), (0.3, 0.0, 0.2))
    part = rest[:, 0] > 0
    maps = estimated_maps(rest, torch.where(part[:, None], gone(rest), rest))
    still = torch.eye(3, dtype=torch.float64)
    wrong = torch.where(
        part, errors(maps, gone, rest), torch.linalg.matrix_norm(maps.to_rest.double() - still)
    )[rest[:, 0].abs() < 0.05]
    assert len(wrong) > 50
    assert float(wrong.mean()) < 0.05
    assert float(maps.stretch.max()) < 2.5


@pytest.mark.parametrize("rest", [sphere(2000), torch.rand(500, 3)], ids=["surface", "solid"])
def test_a_mirrored_object_is_refused(rest: Tensor) -> None:
    with pytest.raises(EditError, match="the move mirrors the object"):
        estimated_maps(rest, rest * torch.tensor([1.0, 1.0, -1.0]))


def test_a_flattened_part_has_maps_of_bounded_anisotropy() -> None:
    rest = torch.rand(800, 3)
    part = rest[:, 0] > 0.6
    moved = torch.where(part[:, None], rest * torch.tensor([1.0, 1.0, 1e-3]), rest)
    maps = estimated_maps(rest, moved)
    sizes = torch.linalg.svdvals(maps.to_rest[part])
    # The exact map squashes by a factor of 1,000.
    assert float((sizes[:, 0] / sizes[:, 2]).max()) < 100
    assert float(torch.linalg.det(maps.to_rest).min()) > 0


def test_folds_inside_an_object_are_mended_and_listed() -> None:
    """Layers of a solid change places: the fit there turns space inside out."""
    rest = torch.rand(1500, 3)
    middle = (rest[:, 2] > 0.3) & (rest[:, 2] < 0.7)
    moved = rest.clone()
    moved[middle, 2] = 1.0 - moved[middle, 2]
    maps = estimated_maps(rest, moved)
    assert len(maps.mended) > 0
    assert bool(middle[maps.mended].float().mean() > 0.8)
    assert float(torch.linalg.det(maps.to_rest).min()) > 0


def test_a_collapsed_part_has_finite_maps_and_is_listed() -> None:
    rest = torch.rand(800, 3)
    part = rest[:, 0] > 0.6
    moved = torch.where(part[:, None], torch.tensor([0.9, 0.5, 0.5]), rest)
    maps = estimated_maps(rest, moved)
    assert bool(torch.isfinite(maps.to_rest).all())
    assert float(torch.linalg.det(maps.to_rest).min()) > 0


def test_tiny_and_huge_objects_are_estimated_alike() -> None:
    rest = sphere()
    for scale in (1e-5, 1e5):
        maps = estimated_maps(rest, scale * rest)
        expected = torch.eye(3).expand(600, 3, 3) / scale
        torch.testing.assert_close(maps.to_rest, expected, rtol=1e-3, atol=1e-3 / scale)


def test_points_that_coincide_have_finite_maps() -> None:
    rest = torch.rand(100, 3)
    rest[40:] = rest[0]
    maps = estimated_maps(rest, similarity()(rest))
    assert bool(torch.isfinite(maps.to_rest).all())


@pytest.mark.parametrize(
    ("rest", "moved", "message"),
    [
        (torch.rand(9, 3), torch.rand(8, 3), r"one shape \(N, 3\), got \(9, 3\) and \(8, 3\)"),
        (torch.rand(3, 3), torch.rand(3, 3), "at least 4 points to estimate from, got 3"),
        (torch.rand(9, 3), torch.full((9, 3), math.nan), "finite deformed points, got NaN"),
        (torch.rand(9, 3), torch.ones(9, 3), "points that extend in space, got all 9 in one place"),
    ],
)
def test_bad_clouds_are_refused(rest: Tensor, moved: Tensor, message: str) -> None:
    with pytest.raises(EditError, match=message):
        estimated_maps(rest, moved)


class Square(Deformation):
    """By NumPy in a given precision: x to x^2, the others as they are."""

    def __init__(self, kind: type[np.floating[Any]]) -> None:
        self.kind = kind

    def __call__(self, points: Tensor) -> Tensor:
        places = points.detach().numpy().astype(self.kind)
        moved = np.concatenate([places[..., :1] ** 2, places[..., 1:]], axis=-1)
        return torch.from_numpy(moved)


@pytest.mark.parametrize(("kind", "bound"), [(np.float64, 1e-8), (np.float32, 1e-3)])
def test_what_is_measured_is_of_each_point_by_itself(
    kind: type[np.floating[Any]], bound: float
) -> None:
    """One point that is broken or far away says nothing about the others."""
    points = torch.rand(40, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    points[3], points[7] = torch.nan, torch.tensor([3e5, 0.0, 0.0])
    found = Square(kind).jacobian(points)
    true = torch.eye(3).double().repeat(40, 1, 1)
    true[:, 0, 0] = 2 * points[:, 0]
    others = torch.tensor([i for i in range(40) if i not in (3, 7)])
    assert float((found - true)[others].abs().max()) < bound
    assert bool(found[3].isnan().any())


def test_one_coordinate_that_autograd_does_not_see_is_measured() -> None:
    class Mixed(Deformation):
        def __call__(self, points: Tensor) -> Tensor:
            x, y, z = points.unbind(dim=-1)
            return torch.stack([2 * x, y, torch.from_numpy(1.5 * z.detach().numpy())], dim=-1)

    points = torch.rand(5, 3, dtype=torch.float64)
    assert torch.allclose(
        Mixed().jacobian(points),
        torch.diag(torch.tensor([2.0, 1.0, 1.5])).double().expand(5, 3, 3),
        atol=1e-9,
    )

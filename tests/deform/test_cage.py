"""Mean value coordinates: what they reproduce, their derivatives, and speed of a bound cage."""

import math

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor

from pcore.deform.cage import Cage, CageDeform
from pcore.deform.proxy import BoundMesh
from pcore.deform.scattered import PointMotion
from pcore.errors import InputError

AFFINE = torch.tensor([[1.0, 0.2, 0.1], [0.0, 1.5, -0.3], [0.4, 0.0, 0.8]]).double()


def as_cage(mesh: trimesh.Trimesh) -> Cage:
    return Cage(
        vertices=torch.from_numpy(np.array(mesh.vertices)),
        faces=torch.from_numpy(np.array(mesh.faces)),
    )


def ball() -> Cage:
    return as_cage(trimesh.creation.icosphere(subdivisions=1))


def box() -> Cage:
    return as_cage(trimesh.creation.box(extents=(2, 2, 2)))


def cloud(count: int = 150, size: float = 3.0) -> Tensor:
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)).double()
    return size * (points - 0.5)


def waved(vertices: Tensor) -> Tensor:
    return vertices + 0.2 * torch.sin(3 * vertices.roll(1, dims=1))


@pytest.mark.parametrize("make", [ball, box])
def test_affine_maps_of_the_cage_are_those_of_space(make):
    cage, points = make(), cloud()
    deform = CageDeform(cage, cage.vertices @ AFFINE.T + 2)
    torch.testing.assert_close(deform(points), points @ AFFINE.T + 2)
    torch.testing.assert_close(deform.jacobian(points), AFFINE.expand(len(points), 3, 3))


def test_a_cage_that_stays_moves_nothing_in_the_last_bit():
    points = cloud().float()
    deform = CageDeform(ball(), ball().vertices)
    assert torch.equal(deform(points), points)
    assert torch.equal(ball().bind(points).moved(ball().vertices), points)


@pytest.mark.parametrize("make", [ball, box])
def test_jacobian_agrees_with_finite_differences_inside_and_outside(make):
    cage, points, step = make(), cloud(), 1e-6
    deform = CageDeform(cage, waved(cage.vertices))
    columns = [
        (deform(points + step * unit) - deform(points - step * unit)) / (2 * step)
        for unit in torch.eye(3, dtype=torch.float64)
    ]
    numeric = torch.stack(columns, dim=-1)
    torch.testing.assert_close(deform.jacobian(points), numeric, rtol=1e-5, atol=1e-5)
    places = points[:5].clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(deform(places).sum(), places)
    torch.testing.assert_close(gradient, deform.jacobian(points[:5]).sum(dim=-2))


def test_the_cage_itself_is_interpolated():
    cage = ball()
    posed = waved(cage.vertices)
    deform = CageDeform(cage, posed)
    torch.testing.assert_close(deform(cage.vertices), posed)
    corners, ends = cage.vertices[cage.faces], posed[cage.faces]
    torch.testing.assert_close(deform(corners.mean(dim=1)), ends.mean(dim=1))
    torch.testing.assert_close(deform(corners[:, :2].mean(dim=1)), ends[:, :2].mean(dim=1))
    on_it = torch.cat([cage.vertices, corners.mean(dim=1), corners[:, :2].mean(dim=1)])
    assert bool(torch.isfinite(deform.jacobian(on_it)).all())


def test_continuous_across_the_plane_of_a_triangle():
    """Outside a box its sides' planes are no place of their own."""
    cage = box()
    deform = CageDeform(cage, waved(cage.vertices))
    plane = torch.tensor([[1.0, 1.7, 0.3], [1.0, 2.5, -1.4], [-2.0, 1.0, 0.2]]).double()
    for axis in range(3):
        shift = torch.zeros(3).double()
        shift[axis] = 1e-7
        torch.testing.assert_close(deform(plane + shift), deform(plane), rtol=0, atol=1e-6)
        torch.testing.assert_close(
            deform.jacobian(plane + shift), deform.jacobian(plane), rtol=0, atol=1e-3
        )


def test_a_textbook_value():
    """At the centre of a regular mesh all coordinates are equal."""
    cage = as_cage(trimesh.creation.icosahedron())
    weights = cage.bind(torch.zeros(1, 3)).weights
    torch.testing.assert_close(weights, torch.full((1, 12), 1 / 12))


def test_a_bound_cage_moves_as_the_map_does():
    cage, points = ball(), cloud(size=1.0).float()
    posed = waved(cage.vertices)
    bound = cage.bind(points)
    torch.testing.assert_close(bound.moved(posed), CageDeform(cage, posed)(points))
    with pytest.raises(InputError, match=r"as many vertices after as before, \(42, 3\), got"):
        bound.moved(posed[:-1])


def test_a_bound_cage_has_the_jacobians_of_the_map(monkeypatch):
    """Also where the map has a kink; and where its slopes would take too much memory."""
    cage = ball()
    points = torch.cat([cloud(), cage.vertices, cage.vertices[cage.faces].mean(dim=1)])
    posed = waved(cage.vertices)
    expected = CageDeform(cage, posed).jacobian(points)
    binding = cage.bind(points)
    found = CageDeform(cage, posed, binding).jacobian(points)
    torch.testing.assert_close(found, expected, rtol=0.0, atol=1e-6)
    quick = CageDeform(cage, posed, binding, quick=True)
    assert torch.equal(quick.jacobian(points), found), "what is known already is as quick"
    assert not torch.equal(
        CageDeform(cage, posed, cage.bind(points), quick=True).jacobian(points), found
    )
    monkeypatch.setattr("pcore.deform.cage._MOST_SLOPES", 0)
    monkeypatch.setattr("pcore.deform.cage.slopes_at", None)
    assert torch.equal(CageDeform(cage, posed, cage.bind(points)).jacobian(points), expected)


def test_asked_again_for_the_same_points_it_remembers_and_for_others_it_does_not():
    cage, points = ball(), cloud()
    deform = CageDeform(cage, waved(cage.vertices))
    fresh = CageDeform(cage, waved(cage.vertices))
    first = deform.jacobian(points)
    assert torch.equal(deform.jacobian(points), first)
    assert torch.equal(deform(points), fresh(points))
    other = points + 0.1
    assert torch.equal(deform(other), fresh(other))
    assert torch.equal(deform.jacobian(other), fresh.jacobian(other))


def test_the_sense_of_the_triangles_does_not_matter():
    cage, points = ball(), cloud()
    turned = Cage(vertices=cage.vertices, faces=cage.faces.flip(1))
    posed = waved(cage.vertices)
    torch.testing.assert_close(CageDeform(turned, posed)(points), CageDeform(cage, posed)(points))


def test_repeated_vertices_along_a_seam_are_fine():
    cage = ball()
    faces = torch.arange(3 * len(cage.faces)).reshape(-1, 3)
    split = Cage(vertices=cage.vertices[cage.faces.reshape(-1)], faces=faces)
    posed, points = waved(cage.vertices), cloud()
    moved = CageDeform(split, posed[cage.faces.reshape(-1)])(points)
    torch.testing.assert_close(moved, CageDeform(cage, posed)(points))


@pytest.mark.parametrize(
    ("faces", "expected"),
    [
        (lambda f: f[:-1], "expected a closed mesh.*got 3 open edges"),
        (lambda f: torch.cat([f[:-1], f[-1:].flip(1)]), "edges whose triangles are turned diff"),
        (lambda f: f + 1, "expected vertex numbers from 0 to 41 in its triangles, got 1 to 42"),
        (lambda f: f[:0], r"expected triangles \(F, 3\)"),
    ],
)
def test_open_and_damaged_cages_are_refused(faces, expected: str):
    with pytest.raises(InputError, match=expected):
        Cage(vertices=ball().vertices, faces=faces(ball().faces))


def test_bad_shapes_of_a_cage_are_refused():
    cage = ball()
    with pytest.raises(InputError, match="as many vertices after as before"):
        CageDeform(cage, cage.vertices[:-1])
    with pytest.raises(InputError, match="deformed cage: expected finite numbers"):
        CageDeform(cage, cage.vertices * math.nan)


def test_points_follow_a_mesh_rigidly_and_exactly_at_its_vertices():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    before = torch.from_numpy(np.array(mesh.vertices))
    faces = torch.from_numpy(np.array(mesh.faces))
    points = torch.nn.functional.normalize(cloud(300), dim=-1) * (0.97 + 0.02 * cloud(300)[:, :1])
    turn = torch.linalg.qr(AFFINE)[0]
    turn = 2 * turn * torch.linalg.det(turn)
    motion = BoundMesh.of(points, before, faces).to(before @ turn.T + 1)
    torch.testing.assert_close(motion(points), points @ turn.T + 1)
    torch.testing.assert_close(motion.jacobian(points), turn.expand(300, 3, 3))
    posed = waved(before)
    at_vertices = BoundMesh.of(before, before, faces).to(posed)
    assert isinstance(at_vertices, PointMotion)
    torch.testing.assert_close(at_vertices(before), posed)


def test_between_the_vertices_of_a_mesh_the_error_is_of_second_order():
    def error(subdivisions: int) -> float:
        mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
        before = torch.from_numpy(np.array(mesh.vertices))
        faces = torch.from_numpy(np.array(mesh.faces))
        middle = before[faces].mean(dim=1)
        away = BoundMesh.of(middle, before, faces).to(waved(before))(middle) - waved(middle)
        return float(away.norm(dim=-1).mean())

    # Edges half as long: a quarter of the error.
    assert 3 < error(2) / error(3) < 5


def test_a_mesh_without_area_is_refused():
    line = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    with pytest.raises(InputError, match="mesh: expected triangles with an area, got none"):
        BoundMesh.of(cloud(), line, torch.tensor([[0, 1, 2]])).to(line)

"""Closest points on a mesh against trying every triangle."""

import numpy as np
import pytest

from pcore.geometry.surface_search import SurfaceSearch, closest_on_triangles


def soup(rng, count, spread):
    """Triangles of very different sizes, unconnected."""
    size = 10 ** rng.uniform(-spread, 0, (count, 1, 1))
    corners = rng.standard_normal((count, 1, 3)) + size * rng.standard_normal((count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def try_all(points, vertices, faces):
    corners = vertices[faces]
    distance = np.empty((len(points), len(faces)))
    for i, point in enumerate(points):
        weights = closest_on_triangles(np.broadcast_to(point, (len(faces), 3)), corners)
        nearest = np.einsum("nk,nkd->nd", weights, corners)
        distance[i] = np.linalg.norm(nearest - point, axis=1)
    return distance.min(axis=1)


@pytest.mark.parametrize("spread", [0.0, 3.0])
@pytest.mark.parametrize("count", [1, 2, 700])
def test_same_as_trying_every_triangle(count, spread):
    rng = np.random.default_rng(count)
    vertices, faces = soup(rng, count, spread)
    points = np.concatenate([2 * rng.standard_normal((100, 3)), 100 * rng.random((5, 3))])
    found = SurfaceSearch(vertices, faces).closest(points)
    assert np.allclose(found.distance, try_all(points, vertices, faces), rtol=1e-9, atol=1e-12)
    place = np.einsum("nk,nkd->nd", found.barycentric, vertices[faces[found.face]])
    assert np.allclose(np.linalg.norm(points - place, axis=1), found.distance)
    assert np.allclose(found.barycentric.sum(axis=1), 1)
    assert found.barycentric.min() >= 0


def test_all_triangles_equally_far():
    """The centre of a sphere cannot be decided by any number of nearest centroids."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=4)
    found = SurfaceSearch(np.asarray(ball.vertices), np.asarray(ball.faces)).closest(
        np.zeros((3, 3))
    )
    heights = np.einsum("nd,nd->n", ball.face_normals, ball.triangles[:, 0])
    assert np.allclose(found.distance, heights.min(), rtol=1e-9)


def test_no_points():
    vertices, faces = soup(np.random.default_rng(0), 3, 0.0)
    found = SurfaceSearch(vertices, faces).closest(np.zeros((0, 3)))
    assert found.face.shape == (0,)
    assert found.barycentric.shape == (0, 3)


@pytest.mark.parametrize(
    ("point", "weights"),
    [
        ((0.25, 0.25, 7.0), (0.5, 0.25, 0.25)),  # above the inside
        ((-1.0, -2.0, 0.0), (1, 0, 0)),  # corner
        ((0.5, -3.0, 1.0), (0.5, 0.5, 0)),  # edge
        ((1.0, 1.0, 0.0), (0, 0.5, 0.5)),  # the long edge
    ],
)
def test_regions_of_a_triangle(point, weights):
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert np.allclose(closest_on_triangles(np.array([point]), corners), [weights])


def test_triangles_without_area_are_their_edges():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1.0, 1, 1]] * 3])
    points = np.array([[1.5, 1.0, 0], [0.0, 0, 0]])
    weights = closest_on_triangles(points, corners)
    assert np.allclose(np.einsum("nk,nkd->nd", weights, corners), [[1.5, 0, 0], [1, 1, 1]])

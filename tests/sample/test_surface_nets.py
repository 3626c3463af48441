import numpy as np

from pcore.sample.surface_nets import surface_nets


def test_sphere_has_the_right_area_volume_and_orientation() -> None:
    def ball(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - 0.1, axis=1) - 0.7

    vertices, faces = surface_nets(ball, np.full(3, -0.9), np.full(3, 1.1), 0.05)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1).sum()
    volume = np.einsum("fc,fc->", normal, corners[:, 0]) / 6
    assert abs(area / (4 * np.pi * 0.7**2) - 1) < 0.01
    assert abs(volume / (4 / 3 * np.pi * 0.7**3) - 1) < 0.01
    assert ((corners.mean(axis=1) - 0.1) * normal).sum(axis=1).min() > 0
    # Closed: Euler's formula of a sphere, every edge shared by two faces.
    assert len(vertices) - 3 * len(faces) // 2 + len(faces) == 2


def test_skipped_blocks_do_not_change_the_mesh() -> None:
    calls = []

    def box(points: np.ndarray) -> np.ndarray:
        calls.append(len(points))
        return np.abs(points).max(axis=1) - 0.43

    vertices, _ = surface_nets(box, np.full(3, -1.0), np.full(3, 1.0), 0.04)
    assert sum(calls) < 0.7 * 56**3
    first, second = np.sort(np.abs(vertices), axis=1)[:, :0:-1].T
    sides = second < 0.36  # the others are rounded off with the edges of the box
    assert sides.sum() > 1000
    assert np.abs(first[sides] - 0.43).max() < 1e-9

"""Errors of point pictures agree with pictures made pixel by pixel."""

from __future__ import annotations

import numpy as np

from pcore.kernels.cpu_point_pictures import picture_errors

SIZE = 6


def slow_error(
    moved: np.ndarray, colors: np.ndarray, camera: np.ndarray, photo: np.ndarray, weight: float
) -> float:
    seen = moved @ camera[:, :3].T + camera[:, 3]
    places = np.floor(seen[:, :2] / seen[:, 2:])
    total = 0.0
    for v in range(SIZE):
        for u in range(SIZE):
            here = [i for i in range(len(moved)) if seen[i, 2] > 0 and (places[i] == (u, v)).all()]
            there, known = photo[v, u, 3] > 0, photo[v, u, 4] > 0
            if known and bool(here) != there:
                total += 1
            elif known and here:
                nearest = min(here, key=lambda i: seen[i, 2])
                total += weight * np.abs(colors[nearest] - photo[v, u, :3]).mean()
    return total


def test_errors_are_those_of_pictures_made_pixel_by_pixel() -> None:
    draw = np.random.default_rng(0)
    points, colors = draw.normal(size=(40, 3)), draw.random((40, 3))
    owners = draw.integers(0, 3, 40)
    motions = np.tile(np.eye(3, 4), (5, 3, 1, 1)) + 0.3 * draw.normal(size=(5, 3, 3, 4))
    lens = np.array([[6.0, 0, 3], [0, 6.0, 3], [0, 0, 1]])
    cameras = np.stack([lens @ np.column_stack([np.eye(3), (0.1, k, 3.0)]) for k in (0, -0.4)])
    photos = draw.random((2, SIZE, SIZE, 5))
    photos[..., 3:] = photos[..., 3:] > 0.3
    given = [array.astype(np.float32) for array in (motions, cameras, photos)]
    found = picture_errors(
        points.astype(np.float32), owners, colors.astype(np.float32), *given, 0.7
    )
    for motion, error in zip(motions, found, strict=True):
        moved = np.einsum("nij,nj->ni", motion[owners][:, :, :3], points) + motion[owners][:, :, 3]
        true = sum(
            slow_error(moved, colors, c, p, 0.7) for c, p in zip(cameras, photos, strict=True)
        )
        assert abs(error - true) < 1e-3
    assert len(set(found.round(3))) > 1

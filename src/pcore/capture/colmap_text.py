"""Text models of COLMAP (.txt)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pcore.capture.colmap_records import (
    ModelImage,
    ModelPoints,
    WrittenCamera,
    model_points,
)
from pcore.errors import SceneError

_MOST = 2.0**62
"""Numbers of points that an array of whole numbers holds."""


def _lines(path: Path) -> Iterator[str]:
    """Lines that are no comment; empty ones are kept."""
    text = path.read_bytes().decode("utf-8-sig", errors="surrogateescape")
    return (line for line in text.splitlines() if not line.startswith("#"))


def _damaged(path: Path, line: str) -> SceneError:
    return SceneError(
        f"{path}: expected a text model of COLMAP, got the line {line[:60]!r}; export it again"
    )


def cameras(path: Path) -> Iterator[WrittenCamera]:
    """Cameras, those that no image is of too."""
    for line in filter(str.strip, _lines(path)):
        try:
            number, model, width, height, *numbers = line.split()
            size, values = (int(width), int(height)), [float(one) for one in numbers]
            yield int(number), model, size, values
        except (ValueError, OverflowError) as problem:
            raise _damaged(path, line) from problem


def images(path: Path) -> Iterator[ModelImage]:
    """Registered images: two lines an image; the second one, of its features, may be empty."""
    lines = _lines(path)
    for line in lines:
        if not line.strip():
            continue
        try:
            _, *pose, camera, name = line.strip().split(maxsplit=9)
            numbers = np.array([float(one) for one in pose])
            seen = np.array([float(one) for one in next(lines, "").split()]).reshape(-1, 3)
            if len(numbers) != 7 or not (np.abs(seen) < _MOST).all():
                raise ValueError("seven numbers make a pose, and features are numbers")
            yield ModelImage(
                name=name,
                camera=int(camera),
                quaternion=numbers[:4],
                translation=numbers[4:],
                places=seen[:, :2],
                points=seen[:, 2].astype(np.int64),
            )
        except (ValueError, OverflowError) as problem:
            raise _damaged(path, line) from problem


def points(path: Path) -> ModelPoints:
    """Points; their tracks say what the images say too."""
    rows: list[tuple[int | float, ...]] = []
    for line in filter(str.strip, _lines(path)):
        try:
            number, *numbers = line.split()[:8]
            if len(numbers) != 7:
                raise ValueError("eight numbers make a point")
            rows.append((int(np.int64(int(number))), *(float(one) for one in numbers)))
        except (ValueError, OverflowError) as problem:
            raise _damaged(path, line) from problem
    return model_points(rows)

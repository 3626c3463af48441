"""Binary models of COLMAP (.bin), little endian."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from pcore.capture.colmap_records import (
    ModelImage,
    ModelPoints,
    WrittenCamera,
    model_camera,
    model_points,
)
from pcore.errors import SceneError

_MODELS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": None,
    "DIVISION": None,
    "SIMPLE_FISHEYE": None,
    "FISHEYE": None,
    "EUCM": None,
    "EQUIRECTANGULAR": None,
}
"""Names by the numbers of binary files, and how many numbers a lens has; None: not looked up."""
_PLACE = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


class _Bytes:
    """A binary file from front to back."""

    def __init__(self, path: Path) -> None:
        self.path, self._at = path, 0
        self._content = path.read_bytes()

    def take(self, form: str) -> tuple[int | float, ...]:
        """Next numbers, little endian."""
        layout = struct.Struct(f"<{form}")
        return layout.unpack(self.bytes(layout.size))

    def count(self, least: int) -> int:
        """A number of entries, of at least so many bytes each."""
        number = int(self.take("Q")[0])
        if number * least > len(self._content) - self._at:
            self._truncated()
        return number

    def bytes(self, size: int) -> bytes:
        """Next bytes."""
        if self._at + size > len(self._content):
            self._truncated()
        self._at += size
        return self._content[self._at - size : self._at]

    def text(self) -> str:
        """Letters up to a zero byte."""
        end = self._content.find(b"\0", self._at)
        if end < 0:
            self._truncated()
        found = self.bytes(end - self._at)
        self._at += 1
        return found.decode(errors="surrogateescape")

    def _truncated(self) -> NoReturn:
        raise SceneError(
            f"{self.path}: expected a whole model of COLMAP, got a truncated or damaged file of "
            f"{len(self._content)} bytes; copy or export it again"
        )


def cameras(path: Path) -> Iterator[WrittenCamera]:
    """Cameras, those that no image is of too."""
    file, models = _Bytes(path), list(_MODELS)
    for _ in range(file.count(24)):
        number, kind, width, height = (int(one) for one in file.take("iiQQ"))
        model = models[kind] if 0 <= kind < len(models) else f"number {kind}"
        length = _MODELS.get(model)
        if length is None:  # Nobody knows where the next camera begins.
            model_camera(path, model, (width, height), [])
        yield number, model, (width, height), [float(one) for one in file.take(f"{length}d")]


def images(path: Path) -> Iterator[ModelImage]:
    """Registered images."""
    file = _Bytes(path)
    for _ in range(file.count(73)):
        file.take("i")
        pose = np.array(file.take("7d"), dtype=np.float64)
        camera, name = int(file.take("i")[0]), file.text()
        seen = np.frombuffer(file.bytes(file.count(24) * 24), dtype=_PLACE)
        yield ModelImage(
            name=name,
            camera=camera,
            quaternion=pose[:4],
            translation=pose[4:],
            places=seen["xy"].astype(np.float64),
            points=seen["point"].astype(np.int64),
        )


def points(path: Path) -> ModelPoints:
    """Points; their tracks say what the images say too."""
    file = _Bytes(path)
    rows: list[tuple[int | float, ...]] = []
    for _ in range(file.count(51)):
        rows.append(file.take("q3d3Bd"))
        file.bytes(file.count(8) * 8)
    return model_points(rows)

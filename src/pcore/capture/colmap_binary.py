"""Binary models of COLMAP (.bin), little endian."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from pcore.capture.colmap_records import (
    ModelCamera,
    ModelImage,
    ModelPoints,
    model_camera,
    model_points,
    parameter_count,
)
from pcore.errors import SceneError

_MODELS = [
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
]
"""Names by the numbers of binary files."""
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


def cameras(path: Path) -> Iterator[tuple[int, ModelCamera]]:
    """Cameras with their numbers."""
    file = _Bytes(path)
    for _ in range(file.count(24)):
        number, kind, width, height = (int(one) for one in file.take("iiQQ"))
        model = _MODELS[kind] if 0 <= kind < len(_MODELS) else f"number {kind}"
        numbers = [float(one) for one in file.take(f"{parameter_count(model)}d")]
        yield number, model_camera(path, model, (width, height), numbers)


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

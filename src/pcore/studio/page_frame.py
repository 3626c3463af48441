"""Where things are on the page: the object's middle at the origin, and as large as viewers like.

viser sends shapes of splats in half precision and depths in steps of 1e-5, so that an object of
1e-3 world units, or of 1e3, would be lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from pcore.gaussians.splats import Splats
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import extent_of, size_of

SIZE = 20.0
"""Diagonal of an object on the page."""
_LARGEST = 60_000.0


@dataclass(frozen=True, kw_only=True)
class PageFrame:
    """Places on the page are `(world - center) * scale`.

    Attributes:
        center: world units.
        scale: page units per world unit.
    """

    center: tuple[float, float, float]
    scale: float

    @classmethod
    def around(cls, points: Tensor) -> PageFrame:
        """Choose that of an object with points (N, 3), world units."""
        low, high = extent_of(points)
        x, y, z = ((low + high) / 2).tolist()
        return cls(center=(x, y, z), scale=SIZE / max(size_of(points), 1e-12))

    def to_page(self, places: ArrayLike) -> NDArray[np.float32]:
        """Places (..., 3) on the page."""
        away = np.asarray(places, dtype=np.float64) - np.asarray(self.center)
        return (away * self.scale).astype(np.float32)

    def to_world(self, places: ArrayLike) -> NDArray[np.float64]:
        """Places (..., 3) in world units."""
        return np.asarray(places, dtype=np.float64) / self.scale + np.asarray(self.center)

    def buffer(self, splats: Splats) -> NDArray[np.uint32]:
        """Splats (N, 8) as viser's page takes them.

        Three words of centre, one for the page, three of six half-precision entries of the
        covariance, one of colour and opacity.
        """
        words = np.zeros((len(splats), 8), dtype=np.uint32)
        words[:, :3] = self.to_page(splats.centers).view(np.uint32)
        entries = splats.covariances.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]] * self.scale**2
        # NumPy makes half floats one by one, in twenty times as long.
        halves = torch.from_numpy(entries.clip(-_LARGEST, _LARGEST)).half()
        words[:, 4:7] = halves.contiguous().numpy().view(np.uint32)
        colors = np.concatenate([splats.rgb, splats.opacities[:, None]], axis=1)
        bytes_ = (colors * 255).round().clip(0, 255).astype(np.uint8)
        words[:, 7] = np.ascontiguousarray(bytes_).view(np.uint32)[:, 0]
        return words

    def camera(
        self, position: ArrayLike, wxyz: ArrayLike, fov_y: float, width: int, height: int
    ) -> Camera:
        """A camera of ours for one of the page (OpenCV axes).

        Args:
            position: (3,) on the page.
            wxyz: (4,) quaternion, page from camera.
            fov_y: vertical field of view, radians.
            width: of the picture, pixels.
            height: of the picture, pixels.
        """
        place = torch.from_numpy(self.to_world(position))
        turn = torch.as_tensor(np.asarray(wxyz, dtype=np.float64))
        return Camera.from_view(place, turn, fov_y, width=width, height=height)

"""How an object stands and which of its points are it, for whoever looks at it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.capture.layouts import RENDERED
from pcore.data.scene import Scene
from pcore.errors import PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.object_region import Region

_LEAST = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Standing:
    """How an object stands.

    Attributes:
        axes: (3, 3) columns in world axes: to the right, ahead and up for who stands before it.
        cameras: of its photos; none where they are not here.
        region: where it is among what it was photographed with; None: all points are it.
    """

    axes: Tensor
    cameras: tuple[Camera, ...] = ()
    region: Region | None = None

    def body(self, points: Tensor) -> Tensor:
        """Which of the object's points at rest (N, 3) are not of a background: (N,) bool."""
        whole = torch.ones(len(points), dtype=torch.bool)
        if self.region is None:
            return whole
        inside = self.region.contains(points.detach().cpu())
        return inside if int(inside.sum()) >= _LEAST else whole


def standing_of(asset: Asset) -> Standing:
    """How an object stands by the cameras of its photos; z is up where these are not here.

    In rendered scenes z is up, whatever the cameras say.
    """
    try:
        scene = asset.scene()
        cameras = tuple(view.camera for view in scene.split("train"))
        if scene.layout == RENDERED:
            return Standing(axes=torch.eye(3), cameras=cameras)
        return Standing(axes=capture_axes(cameras), cameras=cameras, region=_region(scene))
    except PcoreError:
        return Standing(axes=torch.eye(3))


def _region(scene: Scene) -> Region:
    return scene.region or Region(center=scene.center, radius=scene.radius)

"""How an object stands and which of its points are it, for whoever looks at it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.capture.layouts import RENDERED
from pcore.capture.load import has_poses
from pcore.data.held_cameras import held_cameras
from pcore.data.scene import Scene
from pcore.errors import PcoreError
from pcore.geometry.camera import Camera
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.object_region import Region
from pcore.training.locate import locate

_LEAST = 0.01
"""Share of the points; a region with fewer is not where the object is."""


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
        return inside if int(inside.sum()) >= max(2.0, _LEAST * len(inside)) else whole


def standing_of(asset: Asset) -> Standing:
    """How an object stands by the cameras of its photos; z is up where these are not here.

    In rendered scenes z is up, whatever the cameras say.
    """
    try:
        if not has_poses(asset.record.scene_or(None)):
            return Standing(axes=torch.eye(3))  # To find them takes minutes, and another world.
        scene = asset.scene()
        views = scene.split("train")
        cameras = tuple(view.camera for view in views)
        if scene.layout == RENDERED:
            return Standing(axes=torch.eye(3), cameras=cameras)
        axes = capture_axes(held_cameras(views))
        return Standing(axes=axes, cameras=cameras, region=_region(scene))
    except PcoreError:
        return Standing(axes=torch.eye(3))


def _region(scene: Scene) -> Region | None:
    """Where the object is; None where masks leave no background."""
    if scene.region is not None:
        return scene.region
    if all(view.has_alpha for view in scene.split("train")):
        return None
    # Where nothing else tells, what all photos show whole is taken for it.
    found = locate(scene).scene.region
    return found or Region(center=scene.center, radius=scene.radius)

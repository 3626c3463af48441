"""Where the object of a scene is: from its files, masks, sparse points or viewing axes."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from pcore.capture.sparse_region import object_points, region_of_points
from pcore.data.scene import Scene, View
from pcore.errors import InputError
from pcore.geometry.capture_axes import capture_axes
from pcore.geometry.object_region import Region, region_of_box
from pcore.training.hull import coarse_hull
from pcore.training.near_origin import moved, moved_region, near_origin

Source = Literal["box", "files", "masks", "points", "axes"]

_SMALLEST = 0.35
"""A hull of a smaller radius, in radii of the region of the axes, gets a region of its own."""
_WIDE = 0.9
"""Radius in which a hull is searched that the region of the axes cuts off, in distances of the
cameras."""
_ROUNDS = 3
_ROOM = 0.2
"""Room around the box of the object's points in which its hull may lie, in longest sides."""


@dataclass(frozen=True, kw_only=True)
class Located:
    """A scene with the region of its object.

    Attributes:
        scene: with `region`; without one where that of the axes holds the object, as it always did.
        source: what tells where the object is.
        points: (N, 3) sparse points of the object; None where there are none or they are not used.
    """

    scene: Scene
    source: Source
    points: Tensor | None = None

    @property
    def region(self) -> Region:
        """The scene's region, or the sphere of the viewing axes; SceneError for parallel axes."""
        scene = self.scene
        return scene.region or Region(center=scene.center, radius=scene.radius)


def locate(scene: Scene, box: Tensor | None = None) -> Located:
    """Find the region of a scene's object: the user's box, files, masks, sparse points, axes.

    Args:
        scene: its `train` split is looked at, nothing else; masks are decoded.
        box: (2, 3) lower and upper corner that the user gives, world units.

    Raises:
        InputError: a box without extent, or one that no training camera sees.
        SceneError: nothing tells where the object is.
    """
    near_scene, origin = near_origin(scene)
    if origin is None:
        return _located(scene, box)
    near = _located(near_scene, None if box is None else box.double() - origin)
    region, points = near.scene.region, near.points
    # In double precision, for the training that takes it near the origin again.
    region = region and moved_region(region, origin, torch.float64)
    points = None if points is None else moved(points, origin)
    return replace(near, scene=replace(scene, region=region), points=points)


def _located(scene: Scene, box: Tensor | None) -> Located:
    views = scene.split("train")
    if box is not None:
        return Located(scene=replace(scene, region=_boxed(box, views)), source="box")
    points = None
    if scene.sparse is not None:
        points = object_points(scene.sparse, [view.camera for view in views])
    if scene.region is not None:
        inside = None if points is None else points[scene.region.contains(points)]
        return Located(scene=scene, source="files", points=inside)
    if all(view.has_alpha for view in views):
        region = _of_hull(scene, views, points)
        found: Source = "axes" if region is None else "masks"
        return Located(scene=replace(scene, region=region), source=found, points=points)
    if points is not None:
        region = region_of_points(points)
        return Located(scene=replace(scene, region=region), source="points", points=points)
    return Located(scene=scene, source="axes")


def _boxed(box: Tensor, views: Sequence[View]) -> Region:
    if not bool(torch.isfinite(box).all()) or not bool((box[0] < box[1]).all()):
        raise InputError(
            "box: expected a lower corner below an upper one, X Y Z X Y Z in world units, got "
            f"{box.flatten().tolist()}"
        )
    region = region_of_box(box[0], box[1])
    for view in views:
        column, row, depth = view.camera.project(region.center[None])
        inside = (depth > 0) & (column >= 0) & (column < view.camera.width)
        if bool((inside & (row >= 0) & (row < view.camera.height)).all()):
            return region
    raise InputError(
        f"box: none of {len(views)} training views shows its middle {region.center.tolist()}; are "
        "its numbers in the coordinates of the cameras?"
    )


def _of_hull(scene: Scene, views: Sequence[View], points: Tensor | None) -> Region | None:
    """The region of the masks' hull; None where that of the axes holds it well, or there is none.

    Then all stays as it is without a region, to the last bit. Sparse points of the object bound
    the hull where no camera does: views from one side leave it open behind.
    """
    axes = capture_axes([view.camera for view in views])
    voxels, size = coarse_hull(views, scene.lower, scene.upper)
    if len(voxels) > 0:
        reach = ((voxels - scene.center) @ axes).abs().max()
        radius = (voxels - voxels.mean(dim=0)).norm(dim=-1).max()
        if reach + 1.5 * size < scene.radius and radius > _SMALLEST * scene.radius:
            return None
    distances = [float((view.camera.center - scene.center).norm()) for view in views]
    region = Region(center=scene.center, radius=_WIDE * statistics.median(distances))
    if points is not None:
        known = region_of_points(points)
        room = _ROOM * (known.bounds[1] - known.bounds[0]).max()
        region = region_of_box(known.bounds[0] - room, known.bounds[1] + room)
    for _ in range(_ROUNDS):
        voxels, size = coarse_hull(views, *region.bounds, region)
        if len(voxels) == 0:
            return None  # Masks without a common inside are told of where points start.
        # The sphere turns along with the capture; the box only keeps off what is far away.
        turned = voxels @ axes
        center = axes @ (0.5 * (turned.amin(dim=0) + turned.amax(dim=0)))
        radius = float((voxels - center).norm(dim=-1).max()) + size
        box = torch.stack([voxels.amin(dim=0) - 1.5 * size, voxels.amax(dim=0) + 1.5 * size])
        region = Region(center=center, radius=radius, box=box)
    return region

"""Where points start, and whether cameras can see them there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from pcore.data.poses import closest_to_axes
from pcore.data.scene import Scene, View
from pcore.errors import InputError
from pcore.model.papr_config import NetworkFrame
from pcore.training.config import PretrainConfig
from pcore.training.hull import grid_points, hull_of
from pcore.training.near_origin import moved

_GRID_HALF_SIDE = 1.2
_TRACE = 0.05
_FARTHEST = 10.0
"""How many times as far as the object a point may lie to count as seen by a camera."""
_LEAST, _MOST = 0.01, 0.5
"""Share of points in view under which a start is refused, and under which it is told of."""
_CARVED, _OUTSIDE = 0.25, 0.1
"""A point is outside when more than that share of the views that see it have background there; a
cloud with more than that share of points outside is told of."""


@dataclass(frozen=True, kw_only=True)
class StartReport:
    """What training views see of a starting cloud.

    Attributes:
        points: how many there are.
        seen: how many of them at least two views have in the picture, not too far away.
        outside: how many of those the masks have outside of the object; None without masks.
    """

    points: int
    seen: int
    outside: int | None


def start_positions(
    scene: Scene,
    views: Sequence[View],
    config: PretrainConfig,
    frame: NetworkFrame | None,
    generator: torch.Generator,
    origin: Tensor | None = None,
) -> Tensor:
    """Points (N, 3) float32 that training begins with, in the coordinates of the scene.

    Args:
        scene: says where the object is.
        views: training views that are not held out.
        config: how many and where.
        frame: that of the networks, in which the original's grid stands; None: world coordinates.
        generator: of the draws.
        origin: (3,) float64 of the scene's coordinates in the world, in which files are; None: 0.

    Raises:
        InputError: a bad file, no masks for a visual hull, or points that no camera sees.
        TrainingError: the masks have no common inside.
    """
    if config.start == "hull":
        return hull_of(scene, views, config.points, generator, instead="grid")
    if config.start == "grid":
        middle, unit = ((0.0, 0.0, 0.0), 1.0) if frame is None else (frame.center, frame.unit)
        center, half = torch.tensor(middle), _GRID_HALF_SIDE * unit
        return grid_points(config.points, center - half, center + half)
    points = start_from_file(Path(config.start))
    points = points if origin is None else moved(points, -origin)
    check_start(points, views, config.start)
    return points


def start_from_file(path: Path) -> Tensor:
    """Points (N, 3) float32 of a PLY or NPY file; InputError when it holds no such thing."""
    # Reading such files takes a package that no other training needs.
    from pcore.data.points import load_points

    points = load_points(path)
    if len(points) > 1 and bool((points == points[0]).all()):
        raise InputError(
            f"{path}: expected points of some extent to start from, got all {len(points):,} at one "
            "place; give another file, or leave out --init"
        )
    return points


def check_start(points: Tensor, views: Sequence[View], start: str) -> tuple[str, ...]:
    """Refuse a starting cloud that the cameras do not see; say what is odd about it otherwise.

    Args:
        points: (N, 3) world units.
        views: training views.
        start: the file they come from.

    Returns:
        A sentence each.

    Raises:
        InputError: next to none of the points are in view.
    """
    found = report_start(points, views)
    line = (
        f"{start}: {found.seen:,} of {found.points:,} points lie in what the cameras see; are they "
        "in the coordinates of the cameras?"
    )
    if found.seen < max(1.0, _LEAST * found.points):
        raise InputError(line)
    notes = (line,) if found.seen < _MOST * found.points else ()
    if found.outside is not None and found.outside > _OUTSIDE * found.points:
        notes += (
            f"{start}: {found.outside:,} of {found.points:,} points lie outside of the masks of "
            "views that see them; are they in the coordinates of the cameras, with the same axes "
            "and unit?",
        )
    return notes


def report_start(points: Tensor, views: Sequence[View]) -> StartReport:
    """Count the points (N, 3) that views see, and those that masks have outside of the object."""
    poses = torch.stack([view.camera.world_from_camera for view in views])
    center = closest_to_axes(poses)
    masked = all(view.has_alpha for view in views)
    seen = torch.zeros(len(points), dtype=torch.int64)
    carved = torch.zeros(len(points), dtype=torch.int64)
    for view in views:
        camera = view.camera
        column, row, depth = camera.project(points)
        in_view = (depth > 0) & (column >= 0) & (column < camera.width)
        in_view &= (row >= 0) & (row < camera.height)
        valid = view.valid()
        if valid is not None:
            in_view[in_view.clone()] = valid[row[in_view].long(), column[in_view].long()]
        if center is not None:
            in_view &= depth < _FARTHEST * float((camera.center - center).norm())
        seen += in_view
        if masked:
            rows, columns = row[in_view].long(), column[in_view].long()
            carved[in_view] += view.alpha()[rows, columns] <= _TRACE
    enough = seen >= min(2, len(views))
    outside = enough & (carved > _CARVED * seen)
    return StartReport(
        points=len(points),
        seen=int(enough.sum()),
        outside=int(outside.sum()) if masked else None,
    )

"""What carries points to a deformed state: a formula, a mesh, or points whose new places are known.

A state's folder may hold `points_before` and `points_after` (.npy or .ply): places of the same
points of anybody's cloud before and after, as Neural Editor publishes its deformations. They are
matched with ours by position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from pcore.data.points import POINT_SUFFIXES, read_point_file
from pcore.deform.base import Deformation
from pcore.deform.jacobian import analytic_maps
from pcore.deform.scattered import PointMotion
from pcore.errors import SceneError
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import size_of

Move = Callable[[Tensor], Tensor]
Found = TypeVar("Found")

BEFORE, AFTER = "points_before", "points_after"
NEAR = 0.02
"""Median distance of the points from those that they are matched with, as a share of the object's
size: farther is another object, or another world. Gaussians within an object are farther."""
FAR = 0.2
"""Distance, as a share of the object's size, beyond which a point moves as the nearest one does:
local maps say nothing that far away."""
_SITES = 16
"""Neighbours of every point that answer for it; published clouds have up to two million points."""


def remembered(find: Callable[[Tensor], Found]) -> Callable[[Tensor], Found]:
    """The same function of clouds (N, 3), which remembers what it found for each of them."""
    known: list[tuple[Tensor, Found]] = []

    def found(points: Tensor) -> Found:
        for cloud, value in known:
            if cloud is points or torch.equal(cloud, points):
                return value
        known.append((points, find(points)))
        return known[-1][1]

    return found


@dataclass(frozen=True, kw_only=True)
class PointFiles:
    """Files that say where the points of a cloud go in a state.

    Attributes:
        before: places at rest.
        after: places in the state, in the same order.
    """

    before: Path
    after: Path

    def move(self) -> Move:
        """Read the files; what is returned carries points (N, 3) and remembers where they went.

        Raises:
            InputError: a file cannot be read.
            SceneError: other numbers of points.
        """
        before, after = (
            read_point_file(path).positions.double() for path in (self.before, self.after)
        )
        if len(before) != len(after):
            raise SceneError(
                f"{self.after}: expected a new place for each of the {len(before)} points of "
                f"{self.before}, in their order, got {len(after)}"
            )
        return remembered(lambda points: self._carried(points, before, after))

    def _carried(self, points: Tensor, before: Tensor, after: Tensor) -> Tensor:
        places = points.detach().cpu().double()
        index, distance = nearest(before, places, min(_SITES, len(before)))
        size, away = size_of(places), distance[:, 0]
        if float(away.median()) > NEAR * size:
            raise SceneError(
                f"{self.before}: expected points at those of the object, got half of the "
                f"object's {len(places)} points more than {float(away.median()):.3g} away from any "
                f"(expected at most {NEAR * size:.3g}); it must hold the points of this scene at "
                f"rest, in its world, in the order of {self.after.name}"
            )
        used = index.unique()
        moved = PointMotion(before[used], after[used])(places)
        shift = (after - before)[index[:, 0]]
        return torch.where((away > FAR * size)[:, None], places + shift, moved).to(points)


def point_files(folder: Path) -> PointFiles | None:
    """The two files of a state's folder; None where there is none of them.

    Raises:
        SceneError: one of them is missing, or one is there in two formats.
    """
    found = [
        [path for end in POINT_SUFFIXES if (path := folder / f"{name}{end}").is_file()]
        for name in (BEFORE, AFTER)
    ]
    if not any(found):
        return None
    if [len(paths) for paths in found] != [1, 1]:
        raise SceneError(
            f"{folder}: expected {BEFORE} and {AFTER}, each as .npy or .ply, got "
            f"{', '.join(path.name for paths in found for path in paths)}"
        )
    return PointFiles(before=found[0][0], after=found[1][0])


def carried_by(formula: Deformation) -> Move:
    """Carry points by a formula, in double precision."""
    return lambda points: formula(points.double()).to(points)


def by_formula(formula: Deformation) -> Callable[[Tensor, Tensor], LocalMaps]:
    """Local maps of a formula, for points and their new places."""
    return lambda points, moved: analytic_maps(formula, points)


def stay(points: Tensor) -> Tensor:
    """Points where they are."""
    return points

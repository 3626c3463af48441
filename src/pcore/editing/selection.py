"""Which points are meant: chosen in a picture or along the surface, and saved as a region."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from torch import Tensor

from pcore.deform.point_region import path_weights
from pcore.errors import EditError
from pcore.files.atomic import write_atomically
from pcore.geometry.camera import Camera
from pcore.geometry.neighbours import neighbour_graph
from pcore.geometry.visibility import cloud_spacing, visible_from

_LINKS = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class Selector:
    """Chooses among the points of one object.

    Attributes:
        rest: (N, 3) canonical points, world units: paths along the surface are measured there.
    """

    rest: Tensor

    @cached_property
    def graph(self) -> csr_array:
        """The neighbour graph of the points at rest."""
        return neighbour_graph(self.rest.double(), _LINKS)

    @cached_property
    def spacing(self) -> float:
        """How far the points are apart at rest, world units."""
        return cloud_spacing(self.rest)

    def box(
        self,
        points: Tensor,
        camera: Camera,
        corners: tuple[float, float, float, float],
        *,
        through: bool = False,
    ) -> Tensor:
        """Points in a rectangle of a picture, bool (N,).

        Args:
            points: (N, 3) where they are now, world units.
            camera: who looks.
            corners: left, top, right and bottom, pixels.
            through: those behind others, too; otherwise only those that the camera sees.
        """
        column, row, depth = camera.project(points)
        left, top, right, bottom = corners
        inside = (column >= left) & (column <= right) & (row >= top) & (row <= bottom)
        return self._seen(points, camera, inside & (depth > 0), through)

    def brush(
        self,
        points: Tensor,
        camera: Camera,
        stroke: Tensor,
        radius: float,
        *,
        through: bool = False,
    ) -> Tensor:
        """Points that a round brush passes over in a picture, bool (N,).

        Args:
            points: (N, 3) where they are now, world units.
            camera: who looks.
            stroke: (S, 2) columns and rows of the brush, at least one; straight between them.
            radius: pixels.
            through: as `box`.
        """
        column, row, depth = camera.project(points)
        places = torch.stack([column, row], dim=1)
        stroke = stroke.reshape(-1, 2).to(places)
        start, end = (stroke, stroke) if len(stroke) == 1 else (stroke[:-1], stroke[1:])
        way = end - start
        offset = places.unsqueeze(1) - start
        share = (offset * way).sum(dim=2) / way.square().sum(dim=1).clamp_min(1e-12)
        away = (offset - share.clamp(0, 1).unsqueeze(2) * way).norm(dim=2).amin(dim=1)
        return self._seen(points, camera, (away <= radius) & (depth > 0), through)

    def lasso(
        self, points: Tensor, camera: Camera, outline: Tensor, *, through: bool = False
    ) -> Tensor:
        """Points that lie within an outline drawn over a picture, bool (N,).

        Args:
            points: (N, 3) where they are now, world units.
            camera: who looks.
            outline: (S, 2) columns and rows; its ends are joined, and what it goes round twice
                lies outside. With fewer than three places nothing lies within.
            through: as `box`.
        """
        column, row, depth = camera.project(points)
        start = outline.reshape(-1, 2).to(row)
        end = start.roll(-1, dims=0)
        # A ray to the right crosses the outline an odd number of times from within.
        spans = (start[:, 1] > row.unsqueeze(1)) != (end[:, 1] > row.unsqueeze(1))
        slope = (end[:, 0] - start[:, 0]) / (end[:, 1] - start[:, 1])
        crossing = start[:, 0] + (row.unsqueeze(1) - start[:, 1]) * slope
        crossed = spans & (column.unsqueeze(1) < crossing)
        inside = crossed.sum(dim=1) % 2 == 1
        return self._seen(points, camera, inside & (depth > 0), through)

    def geodesic(self, point: int, radius: float, falloff: float = 0.0) -> Tensor:
        """Weights (N,) by paths over the surface from a point: 1 up to a radius, then to 0.

        Args:
            point: its number.
            radius: world units.
            falloff: over which it falls to 0, world units.
        """
        return path_weights(self.graph, torch.tensor([point]), radius, falloff)

    def grow(self, chosen: Tensor, steps: int = 1) -> Tensor:
        """Add the neighbours of what is chosen, bool (N,), so many times."""
        mask = chosen.numpy().astype(bool)
        for _ in range(steps):
            mask = mask | (self.graph.astype(bool) @ mask)
        return torch.from_numpy(mask)

    def rim(self, sources: Tensor, length: float) -> Rim:
        """Where the shortest paths from points (S,), at least one, have a length at rest."""
        longest = float(self.graph.max()) if self.graph.nnz else 0.0
        limit = length + longest  # No link that goes across is left out.
        reached = torch.from_numpy(
            dijkstra(
                self.graph, directed=False, indices=sources.numpy(), min_only=True, limit=limit
            )
        )
        first, second = (torch.from_numpy(one.astype(np.int64)) for one in self.graph.nonzero())
        across = (reached[first] <= length) & (reached[second] > length)
        across &= reached[second].isfinite()
        first, second = first[across], second[across]
        share = (length - reached[first]) / (reached[second] - reached[first])
        return Rim(first=first, second=second, share=share)

    def shrink(self, chosen: Tensor, steps: int = 1) -> Tensor:
        """Take the rim of what is chosen, bool (N,), away, so many times."""
        return ~self.grow(~chosen, steps)

    def _seen(self, points: Tensor, camera: Camera, inside: Tensor, through: bool) -> Tensor:
        inside = inside.cpu()
        return inside if through else inside & visible_from(points, camera, self.spacing)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rim:
    """A line over the surface: places on links (M,) from first to second points, at a share."""

    first: Tensor
    second: Tensor
    share: Tensor

    def at(self, points: Tensor) -> Tensor:
        """The places (M, 3) of the line while the points (N, 3) are somewhere."""
        share = self.share.unsqueeze(1).to(points)
        return torch.lerp(points[self.first], points[self.second], share)

    def thinned(self, points: Tensor, gap: float) -> Rim:
        """Leave out places nearer than a gap to others, while the points (N, 3) are at rest."""
        places = self.at(points.detach().cpu().double()).numpy()
        near, left, kept = KDTree(places), np.ones(len(places), dtype=np.bool_), list[int]()
        for number, place in enumerate(places):
            if left[number]:
                kept.append(number)
                left[near.query_ball_point(place, gap)] = False
        return Rim(first=self.first[kept], second=self.second[kept], share=self.share[kept])


def save_mask(path: Path | str, chosen: Tensor, falloff: float | None = None) -> dict[str, Any]:
    """Write a selection, bool or weights (N,), as .npy, and return the region of an edit file.

    Args:
        path: ends in .npy; an existing file is replaced in one step.
        chosen: which points.
        falloff: of the region, world units; only of a bool selection.

    Raises:
        EditError: nothing is chosen, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix != ".npy":
        raise EditError(f"{path}: expected a file that ends in .npy for a selection")
    if not bool((chosen > 0).any()):
        raise EditError(f"{path}: expected a selection that holds a point, got none")
    buffer = io.BytesIO()
    np.save(buffer, chosen.detach().cpu().numpy())
    try:
        write_atomically(path, buffer.getvalue())
    except OSError as error:
        raise EditError(f"{path}: cannot write the selection ({error.strerror})") from error
    region: dict[str, Any] = {"shape": "mask", "file": str(path.absolute())}
    return region if falloff is None else {**region, "falloff": falloff}

"""The regions that an edit file can name: where an edit acts, or where nothing moves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.sparse import csr_array
from torch import Tensor

from pcore.data.points import read_array
from pcore.deform.frame import axis_vector
from pcore.deform.point_region import PointRegion, path_weights
from pcore.deform.region import Box, HalfSpace, Region, Sphere, Union
from pcore.editing.anchors import AnchorRig
from pcore.editing.fields import Axis, Length, StoredFile, Triple
from pcore.errors import EditError
from pcore.geometry.neighbours import nearest, neighbour_graph
from pcore.geometry.point_cloud import size_of

FALLOFF = 0.05
"""Width of a seam that is not given, as a share of the diagonal of the points' bounding box."""
NEAR = 0.15
"""How far from the object a place on it may be given, as a share of the object's size."""
_LINKS = 8
_KEPT = 4
"""Regions that are kept with the points that they are bound to."""
REGION = 'a region {"shape": "box" or "sphere" or "half_space" or "points" or "geodesic" or "mask"}'


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """What an edit is bound to.

    Attributes:
        points: (N, 3) float64 as they arrive at the edit, world units.
        rest: (N, 3) float64 the same before the first edit; paths over the surface are measured
            here, so that parts which an edit has brought together stay apart.
        rig: of the points at rest with learned weights, where the run has them.
        quick: local maps that have no formula are fitted in one step, for what is dragged.
    """

    points: Tensor
    rest: Tensor
    rig: AnchorRig | None = None
    quick: bool = False

    @cached_property
    def graph(self) -> csr_array:
        """The neighbour graph of the points at rest."""
        return neighbour_graph(self.rest, _LINKS)

    @cached_property
    def regions(self) -> dict[Any, Region]:
        """Regions that are bound to these points already, by what they were bound from."""
        return {}

    @cached_property
    def size(self) -> float:
        """Diagonal of the bounding box of the points at rest, world units."""
        return size_of(self.rest)

    def at(self, points: Tensor) -> Setting:
        """Return the setting of the next edit, where the points (N, 3) are by now."""
        later = replace(self, points=points)
        for name in ("graph", "size"):
            if name in self.__dict__:
                later.__dict__[name] = self.__dict__[name]
        return later


class RegionEntry(BaseModel, ABC):
    """A region of an edit file; world units."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    falloff: Length | None = Field(
        default=None, description="a length of 0 or more over which the edit fades, world units"
    )

    @abstractmethod
    def bind(self, setting: Setting) -> Region:
        """Freeze the region to points.

        Raises:
            EditError: it does not fit the points.
            InputError: its file cannot be read.
        """

    def seam(self, setting: Setting) -> float:
        """Width over which the weight falls: as given, or `FALLOFF` of the object's size."""
        return FALLOFF * setting.size if self.falloff is None else self.falloff


class BoxRegion(RegionEntry):
    """A box along the axes."""

    shape: Literal["box"] = "box"
    lower: Annotated[Triple, Field(description="three finite numbers [x, y, z]")]
    upper: Annotated[Triple, Field(description="three finite numbers [x, y, z]")]

    @model_validator(mode="after")
    def _in_order(self) -> BoxRegion:
        if any(lo > hi for lo, hi in zip(self.lower, self.upper, strict=True)):
            raise ValueError(
                f'"lower": expected no number above that of "upper", got {list(self.lower)} and '
                f"{list(self.upper)}"
            )
        return self

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`."""
        return Box(lower=_double(self.lower), upper=_double(self.upper), falloff=self.seam(setting))


class SphereRegion(RegionEntry):
    """A ball."""

    shape: Literal["sphere"] = "sphere"
    center: Annotated[Triple, Field(description="three finite numbers [x, y, z]")]
    radius: Length

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`."""
        return Sphere(center=_double(self.center), radius=self.radius, falloff=self.seam(setting))


class HalfSpaceRegion(RegionEntry):
    """All that lies on the side of a plane that `normal` points to."""

    shape: Literal["half_space"] = "half_space"
    origin: Annotated[Triple, Field(description="three finite numbers [x, y, z]")] = (0.0, 0.0, 0.0)
    normal: Annotated[
        Axis, Field(description='"x", "y", "z" or a non-zero vector [x, y, z] of finite numbers')
    ]

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`."""
        return HalfSpace(
            origin=_double(self.origin),
            normal=axis_vector(self.normal),
            falloff=self.seam(setting),
        )


class PointsRegion(RegionEntry):
    """Points by their number; it fades along the surface around them."""

    shape: Literal["points"] = "points"
    ids: Annotated[
        tuple[Annotated[int, Field(strict=True, ge=0)], ...],
        Field(min_length=1, description="a list of point numbers from 0, at least one"),
    ]

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`."""
        count = len(setting.points)
        wrong = sorted({number for number in self.ids if number >= count})
        if wrong:
            raise EditError(
                f'region: key "ids": expected numbers from 0 to {count - 1} because there are '
                f"{count} points, got {_listed(wrong)}; numbers belong to one model, use a "
                "geodesic ball, a box or a sphere for edits that are to outlive it"
            )
        return _around(torch.tensor(self.ids), 0.0, self.seam(setting), setting)


class GeodesicRegion(RegionEntry):
    """What can be reached from a place by short paths over the surface."""

    shape: Literal["geodesic"] = "geodesic"
    center: Annotated[Triple, Field(description="three finite numbers [x, y, z]")]
    radius: Length

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`; the center is the point nearest to the place."""
        index, distance = nearest(setting.points, _double(self.center).unsqueeze(0), 1)
        if float(distance) > NEAR * setting.size:
            raise EditError(
                f'region: key "center": expected a place on the object, got {list(self.center)}, '
                f"which is {float(distance):.3g} from the nearest point (object size "
                f"{setting.size:.3g}, at most {NEAR:.0%} of it); is it in world units?"
            )
        return _around(index[0], self.radius, self.seam(setting), setting)


class MaskRegion(RegionEntry):
    """A saved mask of the points: chosen or not, or a weight each."""

    shape: Literal["mask"] = "mask"
    file: Annotated[StoredFile, Field(description="the path of a .npy file")]

    def bind(self, setting: Setting) -> Region:
        """See `RegionEntry.bind`."""
        mask = read_array(self.file)
        count = len(setting.points)
        if mask.shape != (count,):
            raise EditError(
                f"{self.file}: expected a mask of {count} values, one for each point, got the "
                f"shape {mask.shape}; a mask belongs to one model"
            )
        if mask.dtype == np.bool_:
            if not mask.any():
                raise EditError(f"{self.file}: expected a mask that holds a point, got none")
            chosen = torch.from_numpy(np.flatnonzero(mask))
            return _around(chosen, 0.0, self.seam(setting), setting)
        if mask.dtype.kind != "f" or not ((mask >= 0) & (mask <= 1)).all():
            raise EditError(
                f"{self.file}: expected a mask of true and false, or of numbers between 0 and 1, "
                f"got {mask.dtype}{' beyond them or NaN' if mask.dtype.kind == 'f' else ''}"
            )
        if self.falloff is not None:
            raise EditError(
                f'{self.file}: expected no "falloff" for a mask of weights, which fades as they '
                f"say, got {self.falloff:g}"
            )
        return PointRegion(setting.points, torch.from_numpy(mask.astype(np.float64)))


AnyRegion = Annotated[
    BoxRegion | SphereRegion | HalfSpaceRegion | PointsRegion | GeodesicRegion | MaskRegion,
    Field(discriminator="shape"),
]
REGION_SHAPES: dict[str, type[RegionEntry]] = {
    "box": BoxRegion,
    "sphere": SphereRegion,
    "half_space": HalfSpaceRegion,
    "points": PointsRegion,
    "geodesic": GeodesicRegion,
    "mask": MaskRegion,
}


def bind_region(entry: RegionEntry, setting: Setting) -> Region:
    """Freeze a region to points; it is kept with them, for edits that are dragged.

    Raises:
        EditError: it does not fit the points, or no point lies inside: a seam alone is none.
        InputError: its file cannot be read.
    """
    key = (entry, _written(entry.file)) if isinstance(entry, MaskRegion) else entry
    known = setting.regions
    if key not in known:
        region = _bind_region(entry, setting)
        # A slider for the radius of one makes many.
        while len(known) >= _KEPT:
            known.pop(next(iter(known)))
        known[key] = region
    return known[key]


def _written(file: str) -> tuple[int, int] | None:
    """When a file was written, and its size: one that is written anew is read anew."""
    try:
        found = Path(file).stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def _bind_region(entry: RegionEntry, setting: Setting) -> Region:
    region = entry.bind(setting)
    weight = region.weight(setting.points)
    # A mask of numbers has no inside: its weights are meant as they are.
    graded = isinstance(entry, MaskRegion) and bool((weight > 0).any())
    if not graded and not bool((weight == 1).any()):
        fading = int((weight > 0).sum())
        seam = f" ({fading} lie in its seam, where it fades)" if fading else ""
        raise EditError(
            f"empty region: expected the {getattr(entry, 'shape', 'region')} to hold at least one "
            f"of the {len(setting.points)} points, got none{seam}; move it or make it larger"
        )
    return region


def bind_union(entries: tuple[Any, ...], setting: Setting) -> Region | None:
    """Freeze regions that count together; None when there are none."""
    regions = [bind_region(entry, setting) for entry in entries]
    if not regions:
        return None
    return regions[0] if len(regions) == 1 else Union(*regions)


def _around(sources: Tensor, radius: float, falloff: float, setting: Setting) -> Region:
    weights = path_weights(setting.graph, sources, radius, falloff)
    return PointRegion(setting.points, weights)


def _double(values: tuple[float, float, float]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _listed(numbers: list[int]) -> str:
    return ", ".join(map(str, numbers[:5])) + ", ..." * (len(numbers) > 5)

"""Handles that a hand drags: one edit by anchors, changed a handle at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from pcore.errors import EditError

_SAME = 1e-3
"""Share of the object's size within which a place is on the mirror, or one handle another."""

Place = Sequence[float] | Tensor


@dataclass(frozen=True, kw_only=True)
class DraggedHandle:
    """One handle.

    Attributes:
        near: where it was put on the object, as it arrives at the edit, world units.
        to: where it is now; `near` for one that pins.
        rotation: quaternion w, x, y, z by which it turns what it carries; None: its neighbours say.
    """

    near: tuple[float, float, float]
    to: tuple[float, float, float]
    rotation: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Mirror:
    """A plane on both sides of which the same happens.

    Attributes:
        origin: (3,) of the plane, world units.
        normal: (3,) unit.
    """

    origin: tuple[float, float, float]
    normal: tuple[float, float, float]

    @classmethod
    def of(cls, points: Tensor, axis: int = 0) -> Mirror:
        """Through the middle of the bounding box of points (N, 3), across an axis."""
        middle = (points.amin(dim=0) + points.amax(dim=0)) / 2
        normal = torch.eye(3)[axis]
        return cls(origin=_triple(middle), normal=_triple(normal))

    def distance(self, place: Place) -> float:
        """How far on the side of the normal a place is."""
        return float((_vector(place) - _vector(self.origin)) @ _vector(self.normal))

    def image(self, place: Place) -> tuple[float, float, float]:
        """Where a place is seen in the mirror."""
        return _triple(_vector(place) - 2 * self.distance(place) * _vector(self.normal))

    def turned(self, rotation: Sequence[float]) -> tuple[float, float, float, float]:
        """The turn that a turn is seen as: about the image of its axis, the other way round."""
        w, axis = float(rotation[0]), _vector(rotation[1:])
        seen = axis - 2 * (axis @ _vector(self.normal)) * _vector(self.normal)
        x, y, z = _triple(-seen)
        return w, x, y, z


@dataclass(frozen=True, kw_only=True)
class Drag:
    """All handles of one edit; what is between them follows as rigidly as it can.

    Attributes:
        size: of the object, world units.
        handles: by their numbers.
        reach: how far along the surface from the handles anything follows, world units; None: a
            quarter of the size.
        mirror: moves the handle on the other side along.
        count: of anchors.
    """

    size: float
    handles: tuple[DraggedHandle, ...] = ()
    reach: float | None = None
    mirror: Mirror | None = None
    count: int | None = None

    def put(self, place: Place) -> Drag:
        """Put a handle on the object, which pins it there until it is moved.

        With a mirror its image gets one, too, where it is not on the plane.

        Raises:
            EditError: there is a handle already.
        """
        place = _triple(_vector(place))
        if self.at(place) is not None:
            raise EditError(f"handle: expected a place without one, got {list(place)}")
        new = [DraggedHandle(near=place, to=place)]
        if self._off_plane(place):
            image = self._mirror.image(place)
            if self.at(image) is None:
                new.append(DraggedHandle(near=image, to=image))
        return replace(self, handles=(*self.handles, *new))

    def at(self, place: Place) -> int | None:
        """Number of the handle that was put at a place; None without one."""
        for number, handle in enumerate(self.handles):
            away = _vector(handle.near) - _vector(place)
            if float(away.norm()) <= _SAME * self.size:
                return number
        return None

    def moved(
        self,
        number: int,
        to: Place,
        rotation: Sequence[float] | None = None,
    ) -> Drag:
        """Move a handle, and turn it if a quaternion w, x, y, z is given.

        Raises:
            EditError: there is no such handle.
        """
        if not 0 <= number < len(self.handles):
            raise EditError(f"handle: expected a number below {len(self.handles)}, got {number}")
        handles, near = list(self.handles), self.handles[number].near
        turn = None if rotation is None else _quadruple(rotation)
        handles[number] = DraggedHandle(near=near, to=_triple(_vector(to)), rotation=turn)
        other = self.at(self._mirror.image(near)) if self._off_plane(near) else None
        if other is not None and other != number:
            handles[other] = DraggedHandle(
                near=handles[other].near,
                to=self._mirror.image(to),
                rotation=None if turn is None else self._mirror.turned(turn),
            )
        return replace(self, handles=tuple(handles))

    def without(self, number: int) -> Drag:
        """Take a handle away."""
        left = self.handles[:number] + self.handles[number + 1 :]
        return replace(self, handles=left)

    def edit(self) -> dict[str, Any]:
        """The edit, as an edit file has it.

        Raises:
            EditError: there is no handle.
        """
        if not self.handles:
            raise EditError("drag: expected at least one handle, got none")
        handles: list[dict[str, Any]] = []
        for one in self.handles:
            turn = {} if one.rotation is None else {"rotation": list(one.rotation)}
            handles.append({"near": list(one.near), "to": list(one.to), **turn})
        edit: dict[str, Any] = {"type": "anchors", "handles": handles}
        for key, value in (("reach", self.reach), ("count", self.count)):
            if value is not None:
                edit[key] = value
        return edit

    @property
    def _mirror(self) -> Mirror:
        assert self.mirror is not None
        return self.mirror

    def _off_plane(self, place: Place) -> bool:
        """Whether a place has an image of its own."""
        return self.mirror is not None and abs(self.mirror.distance(place)) > _SAME * self.size


def _vector(place: Place) -> Tensor:
    return torch.as_tensor(place, dtype=torch.float64)


def _triple(place: Tensor) -> tuple[float, float, float]:
    x, y, z = place.tolist()
    return x, y, z


def _quadruple(values: Sequence[float]) -> tuple[float, float, float, float]:
    w, x, y, z = (float(one) for one in values)
    return w, x, y, z

"""An asset in a pose, and what is asked of it to take pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import torch
from torch import Tensor

from pcore.asset.content import Content
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.rays import RayBundle


class How(TypedDict, total=False):
    """Options of `Asset.render`; see `Sampling`."""

    samples: int | None
    fast: bool
    detail: float | None
    cancel: Callable[[], bool] | None
    progress: Callable[[float], None] | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Posed:
    """An asset as an edit leaves it; made by `Asset.pose`, drawn by `Asset.render`.

    Attributes:
        points: (N, 3) where its points are, world units.
        local_maps: how space moved around them; None where plain rays do not need it.
        notes: what is odd about the edits and was not refused, a sentence each.
        content: what the kind of object is posed as.
        origin: the content that was posed.
    """

    points: Tensor = field(repr=False)
    local_maps: LocalMaps | None = field(repr=False)
    notes: tuple[str, ...] = ()
    content: Any = field(repr=False)
    origin: Content[Any] = field(repr=False)

    @classmethod
    def of(cls, origin: Content[Any], content: Any, notes: tuple[str, ...]) -> Posed:
        """Make one of what was posed, what that is then, and what was odd about it."""
        return cls(
            points=origin.points_of(content),
            local_maps=origin.local_maps_of(content),
            notes=notes,
            content=content,
            origin=origin,
        )

    @property
    def linear(self) -> Tensor | None:
        """(N, 3, 3) Jacobians at its points, float64; None where nothing remembers them."""
        maps = self.local_maps
        return None if maps is None else torch.linalg.inv(maps.to_rest.double())


def content_of(posed: object, own: Content[Any]) -> Any:
    """Return what an object of this content is posed as.

    Another background, light or colours are no other object: its canonical points are compared, and
    only where the content is not the very one that was posed.

    Raises:
        InputError: of another object, or no pose at all.
    """
    if not isinstance(posed, Posed):
        raise InputError(
            f"asset: expected what `asset.pose` returns, got {type(posed).__name__}; pose it first"
        )
    other = posed.origin
    if other is own or (type(other) is type(own) and same_points(other.points, own.points)):
        return posed.content
    raise InputError(
        f"asset: expected a pose of its own {len(own.points)} points ({type(own).__name__}), got "
        f"one of {len(other.points)} others ({type(other).__name__}); make it with `asset.pose`"
    )


def checked_cameras(cameras: object, frames: int | None = None) -> Sequence[Camera]:
    """Return several cameras, one for each of so many frames, if any; else raises InputError."""
    if not isinstance(cameras, Sequence):
        raise InputError(f"pictures: expected cameras, got {type(cameras).__name__}")
    if not cameras:
        raise InputError("pictures: expected at least one camera, got none")
    for one in cameras:
        if not isinstance(one, Camera):
            raise InputError(f"pictures: expected cameras, got {one!r} among them")
    if frames is not None and len(cameras) != frames:
        raise InputError(f"film: expected a camera for each of {frames} frames, got {len(cameras)}")
    return cameras


def checked_rays(rays: object) -> RayBundle:
    """Return rays; raises InputError where there are none, or something else."""
    if not isinstance(rays, RayBundle):
        raise InputError(f"trace: expected `camera.rays()`, got {type(rays).__name__}")
    return rays.checked()


def same_points(rest: Tensor, points: Tensor) -> bool:
    """Whether canonical points (N, 3) and (M, 3) are the same, to the last bit."""
    return rest.shape == points.shape and torch.equal(rest, points.detach().cpu().to(rest))

"""Everything that can say how an asset is to be moved, bound to its points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from pcore.asset.content import Motion, MovedPoints
from pcore.asset.posed_asset import same_points
from pcore.deform.base import Deformation
from pcore.deform.jacobian import estimated_maps
from pcore.editing.anchors import AnchorRig
from pcore.editing.animation import Animation, load_animation
from pcore.editing.binding import Bound
from pcore.editing.script import EditScript
from pcore.editing.session import EditSession
from pcore.editing.state import EditState
from pcore.errors import EditError, InputError

EditLike = str | Path | Mapping[str, Any] | EditScript | Animation
"""An edit file, its content, or what was read from one."""
Edit = EditLike | EditSession | EditState | Bound | Motion
"""What says how an asset moves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundMotion:
    """A motion of certain points.

    Attributes:
        motion: what moves them; None is nothing.
        notes: what is odd about the edits and was not refused, a sentence each.
    """

    motion: Motion | None
    notes: tuple[str, ...] = ()


def script_of(edit: EditLike, time: float | None = None) -> EditScript:
    """Read an edit, at a time where it has keyframes.

    Args:
        edit: an edit file, its content, or what was read from one.
        time: needed with keyframes; edits that stand still are the same at any.

    Raises:
        EditError: it is not valid, or has keyframes and no time is given.
    """
    if isinstance(edit, EditScript):
        return edit
    animation = animation_of(edit)
    if time is None and animation.end > animation.start:
        raise EditError(
            f"{animation.source}: expected --time between {animation.start:g} and "
            f"{animation.end:g} (time= in Python), because it has keyframes, got none; or use "
            "`pcore animate`"
        )
    return animation.at(animation.start if time is None else time)


def begin_with(edit: EditLike | None, time: float | None) -> EditScript | Animation | None:
    """Read an edit for a session, if any: as it is at a time, or with its keyframes.

    Raises:
        EditError: it is not valid.
    """
    if edit is None:
        return None
    if isinstance(edit, EditScript) or time is not None:
        return script_of(edit, time)
    return animation_of(edit)


def animation_of(edit: str | Path | Mapping[str, Any] | Animation) -> Animation:
    """Read an edit with or without keyframes.

    Raises:
        EditError: it is not valid.
    """
    if isinstance(edit, Animation):
        return edit
    return Animation(edit) if isinstance(edit, Mapping) else load_animation(edit)


def bind_motion(
    edit: object,
    points: Tensor,
    read_rig: Callable[[], AnchorRig | None],
    *,
    time: float | None,
    aware: bool,
) -> BoundMotion:
    """Bind whatever says how an asset moves to its canonical points.

    Args:
        edit: see `Asset.pose`.
        points: (N, 3) canonical points, world units.
        read_rig: gives anchors with learned weights; asked for edits only.
        time: for edits with keyframes.
        aware: whether pictures need to know how space moved around the points: then folds are
            looked for, and maps that nobody gave are estimated.

    Raises:
        EditError: the edit is not valid, does not fit the points, or folds space.
        InputError: a session or moved points of another object, or something else altogether.
    """
    if edit is None or isinstance(edit, Deformation):
        return BoundMotion(motion=edit)
    if isinstance(edit, MovedPoints):
        _same_number(len(edit.positions), points)
        return BoundMotion(motion=_with_maps(edit, points) if aware else edit)
    if isinstance(edit, EditSession):
        edit = edit.state
    if isinstance(edit, EditState):
        edit = edit.bound
    if isinstance(edit, Bound):
        check_bound(edit, points)
        return BoundMotion(motion=edit.known, notes=edit.notes)
    known: tuple[type, ...] = (str, Path, Mapping, EditScript, Animation)
    if not isinstance(edit, known):
        raise InputError(
            "pose: expected an edit file, an edit, an EditSession, a Deformation, MovedPoints or "
            f"None, got {type(edit).__name__}"
        )
    bound = script_of(edit, time).bound(points, rig=read_rig(), check=aware)
    return BoundMotion(motion=bound.known, notes=bound.notes)


def _with_maps(moved: MovedPoints, points: Tensor) -> MovedPoints:
    """The same with local maps; estimated where nobody gave any and something moved."""
    if moved.local_maps is not None or same_points(points, moved.positions):
        return moved
    return replace(moved, local_maps=estimated_maps(points, moved.positions.to(points)))


def _same_number(count: int, points: Tensor) -> None:
    if count != len(points):
        raise InputError(
            f"pose: expected positions of all {len(points)} points of the asset, got {count}"
        )


def check_bound(bound: Bound, points: Tensor) -> None:
    """Refuse edits that were bound to other canonical points (N, 3); raises InputError."""
    rest = bound.setting.rest
    if not same_points(rest, points):
        raise InputError(
            f"asset: expected edits bound to the {len(points)} points of this asset, got edits of "
            f"{len(rest)} others; begin the session with `asset.session()`"
        )

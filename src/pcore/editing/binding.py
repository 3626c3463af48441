"""Edits frozen to a cloud, one after the other, with what never moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from pcore.deform.base import Compose, Deformation, Identity
from pcore.deform.checks import check_finite, check_invertible
from pcore.deform.region import Region
from pcore.deform.weighted import Held, Weighted
from pcore.editing.anchors import AnchorRig
from pcore.editing.edits import Edit
from pcore.editing.regions import RegionEntry, Setting, bind_region, bind_union
from pcore.geometry.extent import size_of

FAR = 2.0
"""How many times its own size an edit moves a point of the object, seldom by intent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """The edits so far, bound.

    Attributes:
        setting: where the points are by now, and where they were before the first edit.
        steps: the deformation of every edit.
        hold: what never moves, in the space before the first edit; None is nothing.
        allow_folds: accept maps that fold space at some of the points.
        notes: what is odd about the edits and was not refused, a sentence each.
    """

    setting: Setting
    steps: tuple[Deformation, ...] = ()
    notes: tuple[str, ...] = ()
    hold: Region | None = None
    allow_folds: bool = False

    @property
    def deformation(self) -> Deformation:
        """All steps as one map of space."""
        if not self.steps:
            return Identity()
        if self.hold is not None:
            return Held(self.steps, self.hold)
        return self.steps[0] if len(self.steps) == 1 else Compose(*self.steps)

    def then(self, edit: Edit, *, check: bool = True) -> Bound:
        """Bind one more edit to the points as they arrive at it.

        Args:
            edit: the next one.
            check: look for folds, which takes the Jacobians of the edit; without, only where the
                points go is computed, for previews while something is dragged.

        Raises:
            EditError: it does not fit the points, or folds space (see `check_invertible`).
            InputError: an amount that no map can have, or a file that cannot be read.
        """
        step = edit.place(self.setting)
        if edit.region is not None or edit.freeze:
            region = None if edit.region is None else bind_region(edit.region, self.setting)
            step = Weighted(step, region, bind_union(edit.freeze, self.setting))
        said = edit.notes(self.setting, step)
        longer = replace(self, steps=(*self.steps, step))
        # What is held changes the Jacobian of every step, so the whole sequence is looked at.
        whole, places = step, self.setting.points
        if self.hold is not None:
            whole, places = longer.deformation, self.setting.rest
        moved = whole(places)
        check_finite(moved)
        if check:
            check_invertible(
                whole, places, allow_folds=self.allow_folds, advice=_advice(edit, self.hold)
            )
        said = (*said, *_leap(self.setting.points, moved))
        notes = [f"edit {len(longer.steps)} ({_kind(edit)}): {line}" for line in said]
        return replace(longer, setting=self.setting.at(moved), notes=(*self.notes, *notes))


def _leap(before: Tensor, after: Tensor) -> tuple[str, ...]:
    """Say so when a point moves by more than makes sense in the units of the object.

    Without its length, which differs from frame to frame of an animation.
    """
    if not len(before):
        return ()
    size = size_of(before)
    if float((after - before).norm(dim=-1).max()) <= FAR * size:
        return ()
    return (
        f"it moves some of the points by more than {FAR:g} times the object's size, which is "
        f"{size:.3g}; are its places in world units, and its amount a share of 1?",
    )


def _advice(edit: Edit, hold: Region | None) -> str:
    """What to do about an edit that folds space."""
    freezes = bool(edit.freeze) or hold is not None
    fading = ["the region"] * (edit.region is not None) + ['what "freeze" holds'] * freezes
    seam = f"widen the falloff of {' or of '.join(fading)}, or " if fading else ""
    return f"{seam}{edit.advice}; plain rays can draw it"


def _kind(edit: Edit) -> str:
    return str(getattr(edit, "type", "edit"))


def begin(
    points: Tensor,
    freeze: tuple[RegionEntry, ...],
    *,
    allow_folds: bool = False,
    rig: AnchorRig | None = None,
) -> Bound:
    """Freeze regions to points (N, 3) float64 before the first edit.

    Raises:
        EditError: a region does not fit the points or holds none of them.
        InputError: a file of a region cannot be read.
    """
    setting = Setting(points=points, rest=points, rig=rig)
    return Bound(setting=setting, hold=bind_union(freeze, setting), allow_folds=allow_folds)

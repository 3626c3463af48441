"""Edits frozen to a cloud, one after the other, with what never moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from pcore.deform.base import SINGULAR, Compose, Deformation, Identity, matrix_product, uprightness
from pcore.deform.checks import check_finite, check_invertible, numbers
from pcore.deform.region import Region
from pcore.deform.weighted import Held, Weighted, blend
from pcore.editing.anchors import AnchorRig
from pcore.editing.edits import Edit
from pcore.editing.regions import RegionEntry, Setting, bind_region, bind_union
from pcore.geometry.point_cloud import size_of

FAR = 2.0
"""How many times its own size an edit moves a point of the object, seldom by intent."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """The edits so far, bound.

    Positions and Jacobians of what came before an edit are kept, so that another last edit costs
    one edit, however long the stack.

    Attributes:
        setting: where the points are by now, and where they were before the first edit.
        steps: the deformation of every edit; the identity of one that is not enabled.
        hold: what never moves, in the space before the first edit; None is nothing.
        allow_folds: accept maps that fold space at some of the points.
        kind: of the last edit.
        said: what is odd about the last edit and was not refused, a sentence each; see `notes`.
        before: the same without the last edit; None before the first one.
    """

    setting: Setting
    steps: tuple[Deformation, ...] = ()
    kind: str = ""
    said: tuple[str, ...] = ()
    hold: Region | None = None
    allow_folds: bool = False
    before: Bound | None = None

    @property
    def deformation(self) -> Deformation:
        """All steps as one map of space."""
        steps = tuple(step for step in self.steps if not isinstance(step, Identity))
        if not steps:
            return Identity()
        if self.hold is not None:
            return Held(steps, self.hold)
        return steps[0] if len(steps) == 1 else Compose(*steps)

    @property
    def known(self) -> Deformation:
        """The same map, which has its values at the points at rest ready."""
        return _Known(self)

    @property
    def linear(self) -> Tensor:
        """(N, 3, 3) Jacobians of all steps at the points at rest, float64."""
        return self._frames[0]

    @cached_property
    def folded(self) -> Tensor:
        """(N,) bool, at which points a step folds space; as `Deformation.folded` of all."""
        before = self.before
        if before is None:
            return torch.zeros(len(self.setting.rest), dtype=torch.bool)
        step, place = self.steps[-1], before.setting.points
        if isinstance(step, Identity):
            return before.folded
        own = self._frames[1] if self._folds_by_jacobian else step.folded(place)
        if self.hold is None:
            return before.folded | own
        own = own & (self._free == 1)
        return before.folded | own | ~(uprightness(self.linear) > SINGULAR)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd about the edits and was not refused, a sentence each."""
        if self.before is None:
            return ()
        label = f"edit {len(self.steps)} ({self.kind})"
        return (*self.before.notes, *(f"{label}: {line}" for line in (*self._mends, *self.said)))

    @property
    def _mends(self) -> tuple[str, ...]:
        """Say so where the last step answers with substitutes for Jacobians."""
        if self.before is None or isinstance(self.steps[-1], Identity):
            return ()
        bad = self.steps[-1].mended(self.before.setting.points)
        if not bool(bad.any()):
            return ()
        return (
            f"at {int(bad.sum())} of {len(bad)} points ({numbers(bad)}) the local map turns space "
            "inside out, as beside a tear; deformation-aware rays use one that does not there",
        )

    @cached_property
    def mended(self) -> Tensor:
        """(N,) bool, at which points a step answers with a substitute for its Jacobian."""
        if self.before is None:
            return torch.zeros(len(self.setting.rest), dtype=torch.bool)
        if isinstance(self.steps[-1], Identity):
            return self.before.mended
        own = self.steps[-1].mended(self.before.setting.points)
        return self.before.mended | (own & (self._free != 0))

    @cached_property
    def _free(self) -> Tensor:
        """(N,) the share of every step that points at rest take."""
        if self.before is not None:
            return self.before._free
        rest = self.setting.rest
        return torch.ones_like(rest[:, 0]) if self.hold is None else 1 - self.hold.weight(rest)

    @property
    def _folds_by_jacobian(self) -> bool:
        """Whether it takes Jacobians to tell where the last step folds space."""
        return type(self.steps[-1]).folded is Deformation.folded

    @cached_property
    def _frames(self) -> tuple[Tensor, Tensor]:
        """See `linear`; and where the last step folds space, if its Jacobians tell."""
        before, rest = self.before, self.setting.rest
        none = torch.zeros(len(rest), dtype=torch.bool)
        if before is None:
            return Identity().jacobian(rest), none
        total, step, place = before.linear, self.steps[-1], before.setting.points
        if isinstance(step, Identity):
            return total, none
        jacobian = step.jacobian(place)
        own = step.folded_given(place, jacobian) if self._folds_by_jacobian else none
        if self.hold is None:
            return matrix_product(jacobian, total), own
        return Held((step,), self.hold).further(step, jacobian, rest, place, total), own

    def then(self, edit: Edit, *, check: bool = True, quick: bool = False) -> Bound:
        """Bind one more edit to the points as they arrive at it.

        Args:
            edit: the next one.
            check: look for folds, which takes the Jacobians of the edit; without, only where the
                points go is computed, for previews while something is dragged.
            quick: fit local maps that have no formula in one step.

        Raises:
            EditError: it does not fit the points, or folds space (see `check_invertible`).
            InputError: an amount that no map can have, or a file that cannot be read.
        """
        if not edit.enabled:
            steps = (*self.steps, Identity())
            return replace(self, steps=steps, said=(), kind=_kind(edit), before=self)
        step, points = self._placed(edit, quick), self.setting.points
        said = edit.notes(self.setting, step)
        moved = step(points)
        if self.hold is not None:
            moved = blend(points, moved, self._free)
        check_finite(moved)
        setting, steps = self.setting.at(moved), (*self.steps, step)
        said = (*said, *_leap(points, moved))
        longer = replace(
            self, setting=setting, steps=steps, said=said, kind=_kind(edit), before=self
        )
        # What is held changes the Jacobian of every step, so the whole sequence is looked at.
        if check and (self.allow_folds or bool(longer.folded.any())):
            whole, places = (step, points) if self.hold is None else (longer.known, setting.rest)
            advice = _advice(edit, self.hold)
            check_invertible(whole, places, allow_folds=self.allow_folds, advice=advice)
        return longer

    def _placed(self, edit: Edit, quick: bool) -> Deformation:
        """An edit bound to the points, in its region."""
        step = edit.place(_quickly(self.setting) if quick else self.setting)
        if edit.region is None and not edit.freeze:
            return step
        region = None if edit.region is None else bind_region(edit.region, self.setting)
        return Weighted(step, region, bind_union(edit.freeze, self.setting))


def _quickly(setting: Setting) -> Setting:
    """The same with quick local maps, and what it knows already."""
    other = replace(setting, quick=True)
    other.__dict__.update({**setting.__dict__, "regions": setting.regions, "quick": True})
    return other


class _Known(Deformation):
    """All edits of a `Bound` as one map; at the points at rest its values are those kept there."""

    def __init__(self, bound: Bound) -> None:
        self._bound, self._map = bound, bound.deformation

    def __call__(self, points: Tensor) -> Tensor:
        return self._bound.setting.points if self._knows(points) else self._map(points)

    def jacobian(self, points: Tensor) -> Tensor:
        return self._bound.linear if self._knows(points) else self._map.jacobian(points)

    def folded(self, points: Tensor) -> Tensor:
        return self._bound.folded if self._knows(points) else self._map.folded(points)

    def mended(self, points: Tensor) -> Tensor:
        return self._bound.mended if self._knows(points) else self._map.mended(points)

    def _knows(self, points: Tensor) -> bool:
        rest = self._bound.setting.rest
        alike = points.dtype == rest.dtype and points.device == rest.device
        return not points.requires_grad and alike and torch.equal(points, rest)


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

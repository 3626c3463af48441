"""Editing as a sequence of commands: do, undo, redo, preview, freeze, save, load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from pcore.deform.base import Deformation
from pcore.editing.anchors import AnchorRig
from pcore.editing.animation import load_animation
from pcore.editing.binding import Bound
from pcore.editing.edits import Edit
from pcore.editing.reading import parse_region
from pcore.editing.regions import RegionEntry
from pcore.editing.script import EditScript, parse_one
from pcore.errors import EditError, InputError


@dataclass(frozen=True, kw_only=True, eq=False)
class EditState:
    """An object between two commands; it never changes.

    Attributes:
        script: the edits so far and what is frozen.
        points: (N, 3) where the points are, in the precision of the canonical ones.
        bound: the edits as they are bound to the points.
    """

    script: EditScript
    points: Tensor
    bound: Bound

    @property
    def deformation(self) -> Deformation:
        """All edits so far as one map of space, from the canonical points."""
        return self.bound.deformation


class EditSession:
    """The points of an object and what was done to them.

    Every command either makes a new state or raises and changes nothing. Binding happens one edit
    at a time, so that a long history does not make the next edit slower unless something is frozen.
    """

    def __init__(
        self, points: Tensor, script: EditScript | None = None, *, rig: AnchorRig | None = None
    ) -> None:
        """Begin with canonical points (N, 3), world units, and with the edits of a script if given.

        Args:
            points: where the session begins.
            script: edits to begin with.
            rig: of these points with learned weights, see `EditScript.bind`.

        Raises:
            EditError: the script does not fit the points.
        """
        self._canonical, self._rig = points.detach().clone(), rig
        self._states = [self._bound(EditScript(edits=()) if script is None else script)]
        self._now = 0

    @property
    def state(self) -> EditState:
        """The present state."""
        return self._states[self._now]

    @property
    def canonical(self) -> Tensor:
        """The points (N, 3) before any edit."""
        return self._canonical.clone()

    @property
    def can_undo(self) -> bool:
        """Whether there is a command to take back."""
        return self._now > 0

    @property
    def can_redo(self) -> bool:
        """Whether a command was taken back that can be done again."""
        return self._now + 1 < len(self._states)

    def do(self, edit: Edit | Mapping[str, Any]) -> EditState:
        """Add an edit after those there are; what was undone before is forgotten.

        Args:
            edit: an edit, or the object of an edit file that describes one.

        Raises:
            EditError: it is not valid, does not fit the points, or folds space.
        """
        return self._keep(self._added(edit, check=True))

    def preview(self, edit: Edit | Mapping[str, Any]) -> EditState:
        """Return the state that `do` would lead to, and stay where we are.

        For showing points while something is dragged: the points are those of `do`, to the last
        bit, but folds are not looked for and no Jacobian is computed. `do` looks for them, and so
        does `pose`, which a picture needs.

        Raises:
            EditError: as `do`, but for folds.
        """
        return self._added(edit, check=False)

    def freeze(self, *regions: RegionEntry | Mapping[str, Any]) -> EditState:
        """Hold regions in the canonical space through all edits, done ones too; none lets all go.

        Raises:
            EditError: a region is not valid or holds no point, or an edit folds with it.
        """
        entries: Any = tuple(parse_region(_plain(region), None) for region in regions)
        now = self.state.script
        script = EditScript(edits=now.edits, freeze=entries).named(now.source)
        return self._keep(self._bound(script))

    def undo(self) -> EditState:
        """Go back to the state before the last command, which is that very state.

        Raises:
            EditError: nothing was done.
        """
        if not self.can_undo:
            raise EditError("undo: expected a command to take back, got none; nothing was done yet")
        self._now -= 1
        return self.state

    def redo(self) -> EditState:
        """Do again what was undone last.

        Raises:
            EditError: nothing was undone, or something else was done since.
        """
        if not self.can_redo:
            raise EditError("redo: expected a command that was undone, got none")
        self._now += 1
        return self.state

    def save(self, path: Path | str) -> None:
        """Write the present edits as an edit file, which gives the same points on the same run.

        Raises:
            EditError: the file cannot be written.
        """
        self.state.script.save(path)

    def load(self, path: Path | str, *, time: float | None = None) -> EditState:
        """Replace the present edits by those of an edit file; `undo` brings them back.

        Args:
            path: the file.
            time: of a file with keyframes, which then stands still: `save` writes its values at
                that time.

        Raises:
            EditError: the file is not valid or does not fit the points, or it has keyframes and no
                time is given.
        """
        animation = load_animation(path)
        if time is None and animation.end > animation.start:
            raise EditError(
                f"{path}: expected time= between {animation.start:g} and {animation.end:g}, "
                "because it has keyframes and a session holds edits that stand still, got none"
            )
        script = animation.at(animation.start if time is None else time)
        return self._keep(self._bound(script))

    def _added(self, edit: Edit | Mapping[str, Any], *, check: bool) -> EditState:
        parsed, now = parse_one(edit), self.state
        edits: Any = (*now.script.edits, parsed)
        script = EditScript(edits=edits, freeze=now.script.freeze).named(now.script.source)
        try:
            bound = now.bound.then(parsed, check=check)
        except (EditError, InputError) as error:
            kind: Any = getattr(parsed, "type", "edit")
            raise EditError(f"edit {len(edits)} ({kind}): {error}") from error
        return self._state(script, bound)

    def _keep(self, state: EditState) -> EditState:
        self._states = [*self._states[: self._now + 1], state]
        self._now += 1
        return state

    def _bound(self, script: EditScript) -> EditState:
        return self._state(script, script.bound(self._canonical, rig=self._rig))

    def _state(self, script: EditScript, bound: Bound) -> EditState:
        # As every command does: in double precision, then in that of the cloud.
        device, kind = self._canonical.device, self._canonical.dtype
        points = bound.setting.points.to(device=device, dtype=kind)
        return EditState(script=script, points=points, bound=bound)


def _plain(region: RegionEntry | Mapping[str, Any]) -> Any:
    return region if isinstance(region, RegionEntry) else dict(region)

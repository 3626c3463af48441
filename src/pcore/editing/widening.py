"""The least falloff, or reach, with which an edit that folds space at a seam does not."""

from __future__ import annotations

from dataclasses import dataclass

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.reading import parse_region
from pcore.editing.regions import FALLOFF, RegionEntry
from pcore.editing.session import EditLike, EditSession
from pcore.editing.stack import (
    EditEntry,
    edit_entry,
    raw_edit,
    raw_region,
)
from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of

_GROWTH = 1.25
_DIGITS = 3
_NARROWEST = 1e-3
"""Of the object's size."""


@dataclass(frozen=True, kw_only=True)
class Widened:
    """An edit and what is frozen, with wider seams.

    Attributes:
        falloff: of all seams that were narrower, and the reach of handles; world units.
        edit: the edit.
        freeze: for `EditSession.freeze`, before the edit is done.
    """

    falloff: float
    edit: EditEntry
    freeze: tuple[RegionEntry, ...]


def widened(session: EditSession, edit: EditLike, at: int | None = None) -> Widened:
    """Find the next falloff, of the edit's region and of what is held, with which nothing folds.

    How far handles reach counts as a falloff. They grow by a quarter at a time from the narrowest
    there is, up to the object's size.

    Args:
        session: where it would be done.
        edit: one that `EditSession.do` refuses because space folds.
        at: as `EditSession.preview`.

    Raises:
        EditError: there is no seam, or the edit folds with any; the edit itself is too strong then.
    """
    entry, held = edit_entry(edit), session.stack.freeze
    raw, frozen = raw_edit(entry), [raw_region(one) for one in held]
    seams = [*([raw["region"]] if raw.get("region") else []), *raw.get("freeze", []), *frozen]
    size = size_of(session.canonical)
    widths = [
        (one, "falloff", FALLOFF * size if one.get("falloff") is None else one["falloff"])
        for one in seams
    ]
    if raw["type"] == "anchors":
        widths.append((raw, "reach", AnchorsEdit.reach_of(raw.get("reach"), size)))
    falloff = max(_NARROWEST * size, min((width for *_, width in widths), default=size))
    while falloff < size:
        falloff = float(f"{_GROWTH * falloff:.{_DIGITS}g}")
        for one, key, width in widths:
            one[key] = max(falloff, width)
        found = Widened(
            falloff=falloff,
            edit=edit_entry(raw),
            freeze=tuple(parse_region(one, None) for one in frozen),
        )
        if _holds(session, found, at):
            return found
    raise EditError(
        "falloff: expected a seam that can be wide enough, found none up to the object's size, "
        f"{size:.3g}; lower the amount of the edit"
    )


def _holds(session: EditSession, found: Widened, at: int | None) -> bool:
    """Whether the edits with these seams fold nowhere."""
    trial = EditSession.resumed(session.canonical, session.history, session.time, rig=session.rig)
    try:
        trial.freeze(*found.freeze)
        trial.preview(found.edit, at, folds="refuse")
    except EditError:
        return False
    return True

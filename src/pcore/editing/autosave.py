"""A session in a file, so that nothing is lost when its process ends: edits, history, view."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from torch import Tensor

from pcore.editing.anchors import AnchorRig
from pcore.editing.animation import Animation
from pcore.editing.contents import content_of
from pcore.editing.history import History, Moment
from pcore.editing.reading import read_edit_file
from pcore.editing.session import EditSession
from pcore.editing.stack import Stack
from pcore.errors import EditError
from pcore.files.atomic import write_atomically

_VERSION = 1
_MOST = 100
"""Moments of the history that are kept, up to the last one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovered:
    """What was found.

    Attributes:
        session: where it was, with its history.
        view: what was kept beside it, such as the camera.
    """

    session: EditSession
    view: Any


def write_session(path: Path | str, session: EditSession, view: Any = None) -> None:
    """Keep a session in a file, which is replaced in one step.

    Args:
        path: the file; its folder is there.
        session: what is kept, with its last hundred commands.
        view: values of JSON that are kept beside it.

    Raises:
        EditError: the file cannot be written; an older one is untouched.
    """
    history = session.history
    first = max(0, min(history.now, len(history.moments) - _MOST))
    moments = history.moments[first:]
    known: dict[str, int] = {}
    numbers = [known.setdefault(json.dumps(one.stack.content), len(known)) for one in moments]
    content = {
        "version": _VERSION,
        "points": fingerprint(session.canonical),
        "time": session.time,
        "now": history.now - first,
        "commands": [
            [one.label, number, one.stack.source]
            for one, number in zip(moments, numbers, strict=True)
        ],
        "edits": [json.loads(text) for text in known],
        "view": view,
    }
    try:
        write_atomically(Path(path), (json.dumps(content) + "\n").encode())
    except OSError as error:
        raise EditError(f"{path}: cannot keep the session ({error.strerror})") from error


def read_session(path: Path | str, points: Tensor, *, rig: AnchorRig | None = None) -> Recovered:
    """Go on with a session that was kept.

    Args:
        path: the file.
        points: (N, 3) canonical points of the object.
        rig: as `EditSession`.

    Raises:
        EditError: no such file, a damaged one, or one of another object.
    """
    content = read_edit_file(Path(path))
    try:
        same = content["points"] == fingerprint(points)
        if content["version"] != _VERSION:
            raise ValueError("another version")
        stacks = [Stack.of(Animation(edits)) for edits in content["edits"]]
        moments = tuple(
            Moment(
                stack=stacks[cast("int", number)].from_source(str(source)),
                label=str(label),
                number=order,
            )
            for order, (label, number, source) in enumerate(content["commands"])
        )
        history = History(moments=moments, now=int(content["now"]))
        _ = history.present
        time, view = float(content["time"]), content["view"]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise EditError(
            f"{path}: expected a session that was kept, got something else or a damaged one"
        ) from error
    if not same:
        raise EditError(
            f"{path}: expected a session of these {len(points)} points, got one of other points; "
            "was the run trained again?"
        )
    return Recovered(session=EditSession.resumed(points, history, time, rig=rig), view=view)


def fingerprint(points: Tensor) -> str:
    """What tells one cloud (N, 3) from another."""
    return hashlib.sha256(content_of(points.float())).hexdigest()[:16]

"""The text at the top of the panel: the object, its edits, what was said, and the tour."""

from __future__ import annotations

from pcore.studio.editor import Editor
from pcore.studio.help_text import LOADING, TOUR


class StatusLine:
    """Knows how far the tour is."""

    def __init__(self, *, tour: bool) -> None:
        """Begin the tour, or without."""
        self._step = 0 if tour else None

    def go_on(self, editor: Editor, *, saved: bool) -> None:
        """Go on with the tour over every step that is done."""
        edits = [editor.raw(index) for index in range(len(editor.session.stack.edits))]
        handles = [one for raw in edits for one in raw.get("handles", ())]
        done = (
            bool(handles),
            any(one.get("to") != one.get("near") for one in handles),
            any(raw["type"] == "twist" and raw["angle_deg"] for raw in edits),
            saved,
        )
        while self._step is not None and self._step < len(done) and done[self._step]:
            self._step += 1
        if self._step == len(done) and not saved:  # The last words were read.
            self._step = None

    def text(self, editor: Editor, *, saved: bool, said: str, drawn: bool) -> str:
        """The text.

        Args:
            editor: whose object and edits.
            saved: whether all edits are.
            said: last; empty for nothing.
            drawn: whether every tab shows a picture already.
        """
        count = len(editor.session.stack.edits)
        kept = "saved" if saved else "not saved"
        edits = "no edits" if not count else f"{count} edit{'s' * (count > 1)}, {kept}"
        number = len(editor.asset.points)
        lines = [f"**{number:,} point{'s' * (number > 1)}** · {edits}"]
        if said or not drawn:
            lines.append(said or LOADING)
        if self._step is not None and self._step < len(TOUR):
            lines.append(TOUR[self._step])
        return "\n\n".join(lines)

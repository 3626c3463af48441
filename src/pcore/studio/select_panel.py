"""The part of the panel that selects points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pcore.studio.editor import Editor
from pcore.studio.help_text import NOT_SELECTED, TOOL_NAMES
from pcore.studio.panel import Panel, Wish

_NO_NAMES = ("none yet",)


class SelectPanel(Panel):
    """Tools, what is selected, and selections with names."""

    def __init__(self, gui: Any, wishes: Mapping[str, Wish]) -> None:
        """Build it where widgets are being put."""
        super().__init__(gui, wishes)
        self._tools = {label: tool for tool, label in TOOL_NAMES.items()}
        self._tool = gui.add_dropdown("Tool", tuple(self._tools), hint="With Shift held")
        self._on_update(self._tool, "tool", said=self._tools)
        self._brush = gui.add_slider(
            "Radius", 0.01, 0.3, 0.005, 0.05, hint="Share of the object; of brush and clicked ball"
        )
        self._on_update(self._brush, "brush")
        visible = gui.add_checkbox("Only what is seen", True)
        self._on_update(visible, "visible_only")
        self._count = gui.add_markdown(NOT_SELECTED)
        actions = gui.add_button_group("Change", ("Grow", "Shrink", "Invert", "Clear"))
        self._on_choice(actions, "selection")
        self._on_click(gui.add_button("Freeze selection", icon="snowflake"), "freeze")
        self._on_click(gui.add_button("Unfreeze everything", color="gray"), "thaw")
        with gui.add_folder("Selections with names"):
            self._named()

    def _named(self) -> None:
        gui = self._gui
        name = gui.add_text("Name", "", hint="Letters, numbers, - and _")
        keep = gui.add_button("Keep the selection", color="gray")
        self._names = gui.add_dropdown("Kept", _NO_NAMES)
        use = gui.add_button_group("Use", ("Select", "Add", "Subtract", "Forget"))

        @keep.on_click
        async def _(event: Any) -> None:
            self._say("name_selection", event, name.value.strip())

        @use.on_click
        async def _(event: Any) -> None:
            kept, what = self._names.value, event.target.value
            if kept in _NO_NAMES:
                return
            if what == "Forget":
                self._say("forget_selection", event, kept)
            else:
                how = "replace" if what == "Select" else what.lower()
                self._say("take_selection", event, kept, how)

    def show(self, editor: Editor, names: list[str]) -> None:
        """Bring it to the state of an editor, with the names of kept selections."""
        shown = editor.shown
        self.count(editor)
        self._tool.value = TOOL_NAMES[shown.tool]
        self._brush.value = shown.brush
        options = tuple(names) or _NO_NAMES
        if self._names.options != options:
            self._names.options = options

    def count(self, editor: Editor) -> None:
        """Say how many points are selected."""
        count = len(editor.shown.chosen)
        points = "point is" if count == 1 else "points are"
        said = f"**{count:,} {points} selected.**" if count else NOT_SELECTED
        if self._count.content != said:
            self._count.content = said

"""The panel of the page: it shows an editor's state and turns clicks into wishes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pcore.editing.stack import raw_edit
from pcore.geometry.extent import size_of
from pcore.studio.drawing import OVERLAYS
from pcore.studio.edit_forms import AXES, CHOICES, NEW, SLIDERS, value_at
from pcore.studio.editor import Editor
from pcore.studio.help_text import NO_BOX, NO_EDIT, SAID

EASINGS = ("smooth", "linear", "in", "out", "step")
Wish = Callable[..., None]
"""Takes the number of the tab, then what the widget says."""


@dataclass(frozen=True)
class Widgets:
    """Handles of viser that change with the state."""

    status: Any
    time: Any
    keys: Any
    play: Any
    overlay: Any
    compare: Any
    still: Any
    name: Any
    progress: Any
    line: Any
    chosen: Any
    owner: Any


class Panels:
    """The widgets, and what they say to whom."""

    def __init__(self, server: Any, wishes: Mapping[str, Wish], *, lit: bool, name: str) -> None:
        """Build everything that is always there.

        Args:
            server: of viser.
            wishes: what to do by name, see `Studio.wishes`.
            lit: whether the object has a light.
            name: of the edit file.
        """
        self._gui, self._wishes = server.gui, wishes
        self._list, self._card, self._sliders = list[Any](), list[Any](), dict[str, Any]()
        self._built: Any = None
        gui = self._gui
        status = gui.add_markdown("Loading&hellip;")
        owner = gui.add_button("Edit in this tab", visible=False, color="orange")
        self._on_click(owner, "take_over")
        history = gui.add_button_group("Session", ("Undo", "Redo", "Save", "Help"))
        self._on_choice(history, "top")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Edit"):
            self._edit_tab()
        with tabs.add_tab("Select"):
            chosen = self._select_tab()
        with tabs.add_tab("Time"):
            time, keys, play = self._time_tab()
        with tabs.add_tab("View"):
            overlay, compare, still = self._view_tab(lit)
        with tabs.add_tab("Files"):
            name_, progress, line = self._files_tab(name)
        shown = (status, time, keys, play, overlay, compare, still, name_, progress, line)
        self._w = Widgets(*shown, chosen, owner)

    # What stands in the panel

    def _edit_tab(self) -> None:
        gui = self._gui
        kind = gui.add_dropdown("New edit", NEW, initial_value=NEW[0])
        add = gui.add_button("Add", icon="plus")

        @add.on_click
        async def _(event: Any) -> None:
            self._say("add", event, kind.value)

        mirror = gui.add_dropdown(
            "Mirror", ("off", *AXES), initial_value="off", hint="Handles move in pairs across it"
        )
        self._on_update(mirror, "mirror")
        self._edits = gui.add_folder("Edits")
        self._values = gui.add_folder("Selected edit", visible=False)
        with self._edits:
            self._list.append(gui.add_markdown(NO_EDIT))

    def _select_tab(self) -> Any:
        gui = self._gui
        chosen = gui.add_markdown(NO_BOX)
        visible = gui.add_checkbox("Only what is seen", True)
        self._on_update(visible, "visible_only")
        self._on_choice(
            gui.add_button_group("Selection", ("Grow", "Shrink", "Invert", "Clear")), "selection"
        )
        self._on_click(gui.add_button("Freeze selection", icon="snowflake"), "freeze")
        self._on_click(gui.add_button("Let everything go", color="gray"), "thaw")
        return chosen

    def _time_tab(self) -> tuple[Any, Any, Any]:
        gui = self._gui
        time = gui.add_slider("At", 0.0, 1.0, 0.01, 0.0)
        self._on_update(time, "time")
        play = gui.add_checkbox("Play", False)
        self._on_update(play, "play")
        easing = gui.add_dropdown("Easing", EASINGS, initial_value=EASINGS[0])
        for label, wish in (("Key selected edit", "key"), ("Take key away", "unkey")):
            button = gui.add_button(label, color=None if wish == "key" else "gray")

            @button.on_click
            async def _(event: Any, wish: str = wish) -> None:
                self._say(wish, event, easing.value)

        camera = gui.add_button_group("Camera", ("Key", "Clear"))
        self._on_choice(camera, "camera_key")
        keys = gui.add_markdown("No keys.")
        return time, keys, play

    def _view_tab(self, lit: bool) -> tuple[Any, Any, Any]:
        gui = self._gui
        overlay = gui.add_dropdown("Overlay", OVERLAYS, initial_value=OVERLAYS[0])
        self._on_update(overlay, "overlay")
        compare = gui.add_slider(
            "Before", 0.0, 1.0, 0.05, 0.0, hint="Share of the picture before the edits"
        )
        self._on_update(compare, "compare")
        still = gui.add_checkbox(
            "Light stands still", lit, disabled=not lit, hint="Off: brightness of the photos"
        )
        self._on_update(still, "still")
        self._on_click(gui.add_button("Whole object (F)", icon="focus-2"), "home")
        return overlay, compare, still

    def _files_tab(self, name: str) -> tuple[Any, Any, Any]:
        gui = self._gui
        named = gui.add_text("Edit file", name)
        for label, wish in (("Save as", "save"), ("Open", "open")):
            button = gui.add_button(label, color="gray")

            @button.on_click
            async def _(event: Any, wish: str = wish) -> None:
                self._say(wish, event, named.value)

        width = gui.add_number("Picture width", 800, min=16, max=4096, step=1)
        shot = gui.add_button("Screenshot", icon="camera")

        @shot.on_click
        async def _(event: Any) -> None:
            self._say("screenshot", event, int(width.value))

        frames = gui.add_number("Frames", 48, min=2, max=2000, step=1)
        film = gui.add_button("Film", icon="movie")

        @film.on_click
        async def _(event: Any) -> None:
            self._say("film", event, int(frames.value), int(width.value))

        progress = gui.add_progress_bar(0.0, visible=False)
        self._on_click(gui.add_button("Stop", color="gray"), "stop_film")
        line = gui.add_markdown("")
        return named, progress, line

    # What the state says

    def show(
        self, editor: Editor, status: str, *, line: str, camera_keys: int, playing: bool
    ) -> None:
        """Bring every widget to the state of an editor; status and line are texts."""
        self._w.status.content = status
        self._w.line.content, self._w.play.value = line, playing
        count = len(editor.shown.chosen)
        self._w.chosen.content = f"**{count:,} points** are selected." if count else NO_BOX
        self._w.overlay.value = editor.shown.overlay
        self._w.compare.value = editor.shown.compare
        self._times(editor, camera_keys)
        built = self._shape(editor)
        if built != self._built:
            self._built = built
            self._rebuild(editor)
        index = editor.shown.selected
        if index is not None:
            raw, size = editor.raw(index), size_of(editor.asset.points)
            for slider in (one.scaled(size) for one in SLIDERS[raw["type"]]):
                widget = self._sliders.get(slider.path)
                value = value_at(raw, slider)
                # A slider that somebody holds already shows this very value.
                if widget is not None and abs(widget.value - value) > 1e-9:
                    widget.value = min(max(value, widget.min), widget.max)

    def several(self, tabs: int) -> None:
        """Only one of several tabs edits; offer to go on in another."""
        self._w.owner.visible = tabs > 1

    def progress(self, share: float | None) -> None:
        """Show how far a film is; None where there is none."""
        self._w.progress.visible = share is not None
        self._w.progress.value = 100 * (share or 0.0)

    def named(self, name: str) -> None:
        """Show another name of the edit file."""
        self._w.name.value = name

    def _times(self, editor: Editor, camera_keys: int) -> None:
        times = editor.key_times
        self._w.time.value = min(max(editor.session.time, self._w.time.min), self._w.time.max)
        if times and (times[0] < self._w.time.min or times[-1] > self._w.time.max):
            self._w.time.min = min(times[0], self._w.time.min)
            self._w.time.max = max(times[-1], self._w.time.max)
        said = ", ".join(f"{time:g}" for time in times)
        keys = f"Keys at {said}." if said else "No keys."
        self._w.keys.content = f"{keys} {camera_keys} camera keys." if camera_keys else keys

    def _shape(self, editor: Editor) -> Any:
        """What the list of edits looks like; where that stays, only values change."""
        entries = [raw_edit(entry) for entry in editor.session.stack.edits]
        names = [(one["type"], one.get("name"), one.get("enabled", True)) for one in entries]
        return names, editor.shown.selected

    def _rebuild(self, editor: Editor) -> None:
        for old in [*self._list, *self._card]:
            old.remove()
        self._list, self._card, self._sliders = [], [], {}
        names, selected = self._shape(editor)
        with self._edits:
            if not names:
                self._list.append(self._gui.add_markdown(NO_EDIT))
            for index, (kind, name, enabled) in enumerate(names):
                label = f"{index + 1}  {name or SAID.get(kind, kind)}" + (
                    "" if enabled else "  (off)"
                )
                button = self._gui.add_button(label, color=None if index == selected else "gray")
                self._on_click(button, "select", index)
                self._list.append(button)
        self._values.visible = selected is not None
        if selected is not None:
            with self._values:
                self._build_card(editor, selected)

    def _build_card(self, editor: Editor, index: int) -> None:
        gui, raw = self._gui, editor.raw(index)
        kind = raw["type"]
        name = gui.add_text("Name", raw.get("name") or SAID.get(kind, kind))
        self._on_update(name, "rename", index)
        enabled = gui.add_checkbox("On", raw.get("enabled", True))
        self._on_update(enabled, "enable", index)
        self._card += [name, enabled]
        size = size_of(editor.asset.points)
        for slider in (one.scaled(size) for one in SLIDERS[kind]):
            value = min(max(value_at(raw, slider), slider.low), slider.high)
            widget = gui.add_slider(slider.label, slider.low, slider.high, slider.step, value)
            self._on_update(widget, "set", index, slider.path)
            self._sliders[slider.path] = widget
            self._card.append(widget)
        for path, options in CHOICES.get(kind, {}).items():
            value = raw.get(path)
            if value is None or value in options:
                choice = gui.add_dropdown(path.capitalize(), options, initial_value=value)
                self._on_update(choice, "set", index, path)
                self._card.append(choice)
        order = gui.add_button_group("Order", ("Up", "Down", "Copy", "Delete"))
        self._on_choice(order, "order", index)
        limit = gui.add_button(
            "Only in the selection", color="gray", hint="Everywhere, if nothing is selected"
        )
        self._on_click(limit, "limit", index)
        self._card += [order, limit]
        if kind == "anchors":
            handle = gui.add_button("Take selected handle away", icon="x", color="gray")
            self._on_click(handle, "remove_handle")
            self._card.append(handle)

    # What people say

    def _say(self, wish: str, event: Any, *values: Any) -> None:
        if event.client_id is not None:  # None: the server changed the value itself.
            self._wishes[wish](int(event.client_id), *values)

    def _on_click(self, button: Any, wish: str, *values: Any) -> None:
        @button.on_click
        async def _(event: Any) -> None:
            self._say(wish, event, *values)

    def _on_choice(self, group: Any, wish: str, *values: Any) -> None:
        @group.on_click
        async def _(event: Any) -> None:
            self._say(wish, event, *values, event.target.value)

    def _on_update(self, widget: Any, wish: str, *values: Any) -> None:
        @widget.on_update
        async def _(event: Any) -> None:
            self._say(wish, event, *values, event.target.value)

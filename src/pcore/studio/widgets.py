"""The panel of the page: it shows an editor's state and turns clicks into wishes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pcore.studio.edit_panel import EditPanel
from pcore.studio.editor import Editor
from pcore.studio.help_text import LOADING, OVERLAY_NAMES, WIDEN
from pcore.studio.panel import Panel, Wish
from pcore.studio.select_panel import SelectPanel
from pcore.studio.shown import MOVING

EASINGS = ("smooth", "linear", "in", "out", "step")
_OVERLAYS = {label: name for name, label in OVERLAY_NAMES.items()}


@dataclass(frozen=True)
class Widgets:
    """Handles of viser that change with the state."""

    status: Any
    widen: Any
    time: Any
    keys: Any
    play: Any
    overlay: Any
    compare: Any
    still: Any
    moving: Any
    rest: Any
    name: Any
    progress: Any
    stop: Any
    line: Any


class Panels(Panel):
    """The widgets, and what they say to whom."""

    def __init__(self, server: Any, wishes: Mapping[str, Wish], *, lit: bool, name: str) -> None:
        """Build everything that is always there.

        Args:
            server: of viser.
            wishes: what to do by name, see `Studio.wishes`.
            lit: whether the object has a light.
            name: of the edit file.
        """
        super().__init__(server.gui, wishes)
        gui = self._gui
        status = gui.add_markdown(LOADING)
        widen = gui.add_button(WIDEN, icon="arrows-maximize", visible=False, color="orange")
        self._on_click(widen, "widen")
        history = gui.add_button_group("Session", ("Undo", "Redo", "Save", "Help"))
        self._on_choice(history, "top")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Edit"):
            self._edits = EditPanel(gui, wishes)
        with tabs.add_tab("Select"):
            self._selection = SelectPanel(gui, wishes)
        with tabs.add_tab("Time"):
            time, keys, play = self._time_tab()
        with tabs.add_tab("View"):
            view = self._view_tab(lit)
        with tabs.add_tab("Files"):
            files = self._files_tab(name)
        shown = (status, widen, time, keys, play, *view, *files)
        self._w = Widgets(*shown)
        self._offers = dict[int, Any]()

    # What stands in the panel

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

    def _view_tab(self, lit: bool) -> tuple[Any, ...]:
        gui = self._gui
        overlay = gui.add_dropdown("Mark what is", tuple(_OVERLAYS), hint="Overlay (O)")
        self._on_update(overlay, "overlay", said=_OVERLAYS)
        compare = gui.add_slider(
            "Before", 0.0, 1.0, 0.05, 0.0, hint="Share of the picture before the edits"
        )
        self._on_update(compare, "compare")
        still = gui.add_checkbox(
            "Light stands still", lit, disabled=not lit, hint="Off: brightness of the photos"
        )
        self._on_update(still, "still")
        moving = gui.add_dropdown(
            "While moving", tuple(MOVING), hint="Points are light; exact pictures are slower"
        )
        self._on_update(moving, "moving")
        rest = gui.add_checkbox("Exact when it rests", True, hint="Off: what moves stays shown")
        self._on_update(rest, "rest")
        self._on_click(gui.add_button("Whole object (F)", icon="focus-2", color="gray"), "home")
        dark = gui.add_button("Dark or light panel (T)", icon="moon", color="gray")
        self._on_click(dark, "dark")
        return overlay, compare, still, moving, rest

    def _files_tab(self, name: str) -> tuple[Any, ...]:
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
        stop = gui.add_button("Stop the film", color="gray", visible=False)
        self._on_click(stop, "stop_film")
        line = gui.add_markdown("")
        return named, progress, stop, line

    # What the state says

    def show(
        self,
        editor: Editor,
        status: str,
        *,
        names: list[str],
        line: str,
        camera_keys: int,
        playing: bool,
    ) -> None:
        """Bring every widget to the state of an editor.

        Args:
            editor: which.
            status: text of the top.
            names: of kept selections.
            line: text of the command that makes the same picture.
            camera_keys: how many cameras are keyed.
            playing: whether the timeline runs.
        """
        self._w.status.content = status
        self._w.line.content, self._w.play.value = line, playing
        self._w.overlay.value = OVERLAY_NAMES[editor.shown.overlay]
        self._w.compare.value = editor.shown.compare
        self._w.moving.value, self._w.rest.value = editor.shown.moving, editor.shown.rest
        self._w.widen.visible = editor.widens
        self._times(editor, camera_keys)
        self._edits.show(editor, names)
        self._selection.show(editor, names)

    def say(self, status: str) -> None:
        """Show another text at the top, until the next state."""
        self._w.status.content = status

    def dragged(self, editor: Editor, status: str) -> None:
        """Show what changes while something is dragged: the text at the top, and the selection."""
        if self._w.status.content != status:
            self._w.status.content = status
        self._selection.count(editor)

    def roles(self, clients: Mapping[int, Any], owner: int | None) -> None:
        """Only one of several tabs edits; offer to go on in each of the others."""
        for tab in [*self._offers]:
            if tab not in clients or tab == owner:
                self._offers.pop(tab).remove()
        for tab, client in clients.items():
            if tab != owner and tab not in self._offers:
                order = self._w.status.order + 0.5
                button = client.gui.add_button("Edit in this tab", color="orange", order=order)
                self._on_click(button, "take_over")
                self._offers[tab] = button

    def progress(self, share: float | None) -> None:
        """Show how far a film is; None where there is none."""
        self._w.progress.visible = self._w.stop.visible = share is not None
        self._w.progress.value = 100 * (share or 0.0)

    def named(self, name: str) -> None:
        """Show another name of the edit file."""
        self._w.name.value = name

    def at(self, time: float) -> None:
        """Show another time."""
        self._w.time.value = min(max(time, self._w.time.min), self._w.time.max)

    def _times(self, editor: Editor, camera_keys: int) -> None:
        times = editor.key_times
        self.at(editor.session.time)
        if times and (times[0] < self._w.time.min or times[-1] > self._w.time.max):
            self._w.time.min = min(times[0], self._w.time.min)
            self._w.time.max = max(times[-1], self._w.time.max)
        said = ", ".join(f"{time:g}" for time in times)
        keys = f"Keys at {said}." if said else "No keys."
        self._w.keys.content = f"{keys} {camera_keys} camera keys." if camera_keys else keys

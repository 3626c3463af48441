"""The page as a whole: tabs, their wishes, one worker that fulfils them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from pcore.asset.asset import Asset
from pcore.studio.actions import (
    COMMANDS,
    EDITOR_COMMANDS,
    NEWEST,
    NEWEST_SHOWN,
    OF_TAB,
    SHOWN,
    Actions,
)
from pcore.studio.dialogs import ask_to_restore, show_help
from pcore.studio.drawing import Drawer
from pcore.studio.editor import Editor
from pcore.studio.gestures import Gestures
from pcore.studio.guard import Guard
from pcore.studio.guide_nodes import GuideNodes
from pcore.studio.guides import GuideMaker
from pcore.studio.handle_nodes import HandleNodes
from pcore.studio.help_text import FOLDS, WORKING
from pcore.studio.hotkeys import HOTKEYS
from pcore.studio.outputs import Outputs
from pcore.studio.page_frame import SIZE, PageFrame
from pcore.studio.select_actions import SELECT_COMMANDS, SelectActions
from pcore.studio.server import open_server, paint, run_script, sweep
from pcore.studio.showing import Showing
from pcore.studio.status_line import StatusLine
from pcore.studio.stroke_nodes import HELD, StrokeNodes
from pcore.studio.studio_files import StudioFiles
from pcore.studio.viewport import Viewport
from pcore.studio.widgets import Panels

_HOME = (0.75, -0.75, 0.5)
"""Direction from the object to the first camera."""
_AWAY = 1.5
"""Distance of the first camera in sizes of the object."""
_ANGLE = 0.7
"""Its vertical field of view, radians."""

_SWEEP = 100
"""Commands between two sweeps of messages that nobody needs."""


def _nowhere(error: Exception) -> None:
    """Say nothing."""


class Studio(Gestures):
    """A running page. `close` ends it."""

    def __init__(
        self,
        asset: Asset,
        guard: Guard,
        outputs: Outputs,
        *,
        title: str,
        tour: bool = False,
        report: Callable[[Exception], None] = _nowhere,
    ) -> None:
        """Open the page; it answers at `guard.url` when this returns.

        Args:
            asset: the object.
            guard: who may use the page.
            outputs: where it may write; its edit file is opened if it exists.
            title: of the page.
            tour: show the first steps.
            report: told of what should not happen, for the terminal.

        Raises:
            EditError: the edit file is not valid or does not fit the points.
            DependencyError: viser is not installed.
            InputError: the port is taken.
        """
        super().__init__(report)
        edit = outputs.edit if outputs.edit.is_file() else None
        self.editor, self.title = Editor(asset, edit), title
        self.outputs, self._line = outputs, StatusLine(tour=tour)
        self.drawer = Drawer(asset)
        self.frame = PageFrame.around(asset.points)
        self.files = StudioFiles(self)
        self.actions, self.selecting = Actions(self), SelectActions(self)
        self._guides, self._refreshed = GuideMaker(), 0
        self.wishes = self._wishes()
        self._showing = Showing(self.editor, self.drawer, self.frame)
        self.url = guard.url
        self.server = open_server(guard, label=title)
        self._wire()
        self.worker.start()
        self.worker.do(self._refresh)

    def close(self) -> None:
        """End the page; the autosave stays."""
        self.actions.playing = False
        self.perform(lambda: None)
        self.worker.stop()
        self.files.close()
        self.server.stop()

    # Tabs

    def _wire(self) -> None:
        server: Any = self.server
        scene = server.scene
        camera = server.initial_camera
        camera.position = self._eye
        camera.look_at, camera.up, camera.fov = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), _ANGLE
        self.panels = Panels(
            server,
            self.wishes,
            lit=self.editor.asset.light is not None,
            name=self.outputs.edit.name,
        )
        self.nodes = HandleNodes(
            scene,
            self.frame,
            selected=self._select_handle,
            dragged=self._dragged,
            scaled=self._scaled,
        )
        self.strokes = StrokeNodes(scene, self.frame, self._stroked, self._boxed)
        self.guides = GuideNodes(scene, self.frame)
        server.on_client_connect(self._joined)
        server.on_client_disconnect(self._left)
        for keys in ("cmd/ctrl", "alt", *HELD):
            scene.on_click(modifier=keys)(self._clicked)
        for label, key, modifier, wish, *values in HOTKEYS:
            self._command(label, key, modifier, wish, values)
        run_script(server)

    @property
    def _eye(self) -> tuple[float, float, float]:
        """Where the first camera is, on the page."""
        x, y, z = (_AWAY * SIZE * one for one in _HOME)
        return x, y, z

    def _command(
        self, label: str, key: str, modifier: str | None, wish: str, values: list[Any]
    ) -> None:
        command = self.server.gui.add_command(label, hotkey=key, modifier=modifier)  # pyright: ignore

        @command.on_trigger
        async def _(event: Any) -> None:
            self.wishes[wish](int(event.client_id), *values)

    async def _joined(self, client: Any) -> None:
        viewport = Viewport(client, self.frame, self.editor.asset.provenance.background)

        @client.camera.on_update
        async def _(_: Any) -> None:
            if viewport.number == self._owner:
                self.nodes.turned()
            if self.editor.shown.exact:
                self.worker.draw(self._move, self._rest)
                return
            viewport.moving()
            self.worker.draw(None, self._rest)

        def join() -> None:
            if self._join(viewport):
                self._offer(client)
            viewport.fit(self._eye)
            self._refresh()

        self.worker.do(join)

    async def _left(self, client: Any) -> None:
        def leave() -> None:
            self._leave(int(client.client_id))
            self._refresh()

        self.worker.do(leave)

    def _offer(self, client: Any) -> None:
        """Offer what an earlier page could not save."""
        if self.outputs.left_over and not self.editor.session.can_undo:
            ask_to_restore(client.gui, lambda: self.perform(self.files.restore))

    # Wishes

    def _wishes(self) -> dict[str, Callable[..., None]]:
        """What widgets and keys ask for, by name; each takes the number of the tab first."""
        actions = self.actions
        wishes = {name: self._wish(getattr(actions, name)) for name in COMMANDS}
        wishes |= {name: self._wish(getattr(self.editor, name)) for name in EDITOR_COMMANDS}
        wishes |= {name: self._wish(_shows(actions, name)) for name in SHOWN}
        wishes |= {name: self._newest_of(name, getattr(actions, name)) for name in NEWEST}
        wishes |= {name: self._newest_of(name, _shows(actions, name)) for name in NEWEST_SHOWN}
        wishes |= {name: self._of_tab(getattr(actions, name)) for name in OF_TAB}
        wishes |= {name: self._wish(getattr(self.selecting, name)) for name in SELECT_COMMANDS}
        wishes["slide"] = self._slide
        wishes["cancel"] = self._cancel
        return wishes | {
            "top": self._top,
            "home": self._home,
            "help": self._help,
            "dark": self._dark,
            "stop_film": self._stop_film,
            "take_over": self._take_over,
        }

    def _top(self, tab: int, name: str) -> None:
        if name == "Save":
            self.wishes["save"](tab, self.files.edit.name)
        else:
            self.wishes[name.lower()](tab)

    def _stop_film(self, tab: int) -> None:
        if tab == self._owner:
            self.files.stop()

    def _home(self, tab: int) -> None:
        if (viewport := self._viewports.get(tab)) is not None:
            camera = viewport.client.camera
            camera.look_at, camera.position = (0.0, 0.0, 0.0), self._eye
            viewport.fit(self._eye)

    def _help(self, tab: int) -> None:
        if (viewport := self._viewports.get(tab)) is not None:
            show_help(viewport.client.gui)

    def _dark(self, tab: int) -> None:
        if (viewport := self._viewports.get(tab)) is not None:
            viewport.dark = not viewport.dark
            paint(viewport.client.gui, dark=viewport.dark)

    # Showing

    def _refresh(self) -> None:
        """Bring everything to the editor's state: panel, handles, splats, and pictures at rest."""
        editor = self.editor
        self._note()
        self._line.go_on(editor, saved=self.files.saved)
        if (lost := editor.lost) is not None:
            self._complain(lost)
        self._refreshed += 1
        if self._refreshed % _SWEEP == 0:
            sweep(self.server)
        self.panels.show(
            editor,
            self._status(),
            names=self.selecting.named.names,
            line=self.files.line,
            camera_keys=len(self.files.cameras),
            playing=self.actions.playing,
        )
        clients = {number: one.client for number, one in self._viewports.items()}
        self.panels.roles(clients, self._owner)
        self.strokes.use(editor.shown.tool)
        self.strokes.hear(self._clicked, editor.shown.click != "nothing")
        for viewport in self._viewports.values():
            if viewport.number == self._owner:
                self.nodes.face(viewport.client)
        self.nodes.show(editor, warn=False, moved=True)
        self.guides.show(self._guides.of(editor))
        self.worker.draw(self._move, self._rest)

    def _note(self) -> None:
        self.files.note()

    def _show_drag(self) -> None:
        editor = self.editor
        warn = len(editor.state.folds) > 0
        moved = editor.sliding or self.actions.playing
        self.nodes.show(editor, warn=warn, moved=moved)
        self.panels.dragged(editor, FOLDS.format(editor.back) if editor.back else self._status())
        self.guides.show(self._guides.of(editor))
        self.worker.draw(self._move, self._rest)

    def _let_go(self) -> None:
        self.nodes.release()
        self.selecting.take_back()
        self.editor.cancel()

    def _show_working(self) -> None:
        self.panels.say(WORKING)

    def _move(self) -> None:
        self._showing.move(list(self._viewports.values()))

    def _rest(self, cancelled: Callable[[], bool]) -> Iterator[None]:
        before = self._status()
        for _ in self._showing.rest(list(self._viewports.values()), cancelled):
            yield
            if (text := self._status()) != before:  # The first picture is there.
                self.panels.say(before := text)

    def _status(self) -> str:
        # Who opens the page sees the last text before the worker takes the new tab in.
        tabs = self._viewports.values()
        drawn = bool(tabs) and all(viewport.drawn for viewport in tabs)
        saved, said = self.files.saved, self._said
        return self._line.text(self.editor, saved=saved, said=said, drawn=drawn)


def _shows(actions: Actions, name: str) -> Callable[[Any], None]:
    """Give what shows another value of the one thing of `Shown` that has this name."""
    return lambda value: actions.show(**{name: value})

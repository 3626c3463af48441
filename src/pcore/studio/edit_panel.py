"""The part of the panel that edits: the list, and the card of the selected edit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pcore.editing.stack import raw_edit
from pcore.geometry.point_cloud import size_of
from pcore.studio.edit_forms import AXES, CAGES, CHOICES, LABELS, NEW, SLIDERS, SOFT, value_at
from pcore.studio.edit_handles import TURNING
from pcore.studio.editor import Editor
from pcore.studio.formula_handles import CENTRED
from pcore.studio.handle_pose import HandlePose, degrees_of
from pcore.studio.help_text import GIZMO_NAMES, NO_EDIT
from pcore.studio.panel import Panel, Wish
from pcore.studio.select_actions import EVERYWHERE, SELECTED
from pcore.studio.shown import CLICKS, GIZMOS

_OWN = "as it is"


class EditPanel(Panel):
    """New edits, mirror and locks, the list, and a card."""

    def __init__(self, gui: Any, wishes: Mapping[str, Wish]) -> None:
        """Build it where widgets are being put."""
        super().__init__(gui, wishes)
        self._list, self._card, self._sliders = list[Any](), list[Any](), dict[str, Any]()
        self._built: Any = None
        self._name: Any = None
        self._typed: str | None = None
        self._place: Any = None
        self._turn: Any = None
        kinds = {LABELS[kind]: kind for kind in (*NEW, *CAGES)}
        kind = gui.add_dropdown("New edit", tuple(kinds))
        add = gui.add_button("Add", icon="plus")

        @add.on_click
        async def _(event: Any) -> None:
            self._say("add", event, kinds[kind.value])

        self._mirror = gui.add_dropdown(
            "Mirror", ("off", *AXES), hint="Handles move in pairs across it (M)"
        )
        self._on_update(self._mirror, "mirror")
        self._lock = gui.add_dropdown(
            "Only along", ("off", *AXES), hint="Handles move along this axis alone (X, Y, Z)"
        )
        self._on_update(self._lock, "lock")
        gizmos = {GIZMO_NAMES[name]: name for name in GIZMOS}
        self._gizmo = gui.add_dropdown("Gizmo", tuple(gizmos), hint="What arrows and rings do")
        self._on_update(self._gizmo, "gizmo", said=gizmos)
        self._click = gui.add_dropdown(
            "A click puts", CLICKS, hint="Without a key; Ctrl-click puts a handle, Alt-click a pin"
        )
        self._on_update(self._click, "click")
        self._edits = gui.add_folder("Edits")
        self._values = gui.add_folder("Selected edit", visible=False)
        with self._edits:
            self._list.append(gui.add_markdown(NO_EDIT))

    def show(self, editor: Editor, names: list[str]) -> None:
        """Bring it to the state of an editor, with the names of kept selections."""
        self._mirror.value, self._lock.value = editor.shown.mirror, editor.shown.lock
        self._click.value = editor.shown.click
        self._gizmo.value = GIZMO_NAMES[editor.shown.gizmo]
        rows = [row[::2] for row in _rows(editor)]
        built = (rows, editor.shown.selected, _region(editor), names, _held(editor))
        if built != self._built:
            self._built = built
            self._rebuild(editor, names)
        for button, label in zip(self._list, _labels(editor), strict=False):
            if button.label != label:
                button.label = label
        raw = editor.present
        if raw is not None:
            self._show_name(raw)
            for slider in _sliders(editor, raw):
                widget, value = self._sliders.get(slider.path), value_at(raw, slider)
                # A slider that somebody holds already shows this very value.
                if widget is not None and abs(widget.value - value) > 1e-9:
                    widget.value = min(max(value, widget.min), widget.max)
            self._show_handle(editor)

    def _show_name(self, raw: dict[str, Any]) -> None:
        """Show the name of an edit, unless letters were typed after it that are yet to come."""
        if self._typed is not None:
            if raw.get("name") == (self._typed or None):
                self._typed = None
            return
        name = raw.get("name") or LABELS[raw["type"]]
        if self._name.value != name:
            self._name.value = name

    def _show_handle(self, editor: Editor) -> None:
        number, handles = editor.shown.handle, editor.handles
        if number is None or number >= len(handles):
            return
        place, turn = _rounded(editor, handles[number])
        for widget, value in ((self._place, place), (self._turn, turn)):
            if widget is not None and tuple(widget.value) != value:
                widget.value = value

    def _rebuild(self, editor: Editor, names: list[str]) -> None:
        for old in [*self._list, *self._card]:
            old.remove()
        self._list, self._card, self._sliders = [], [], {}
        self._name = self._typed = self._place = self._turn = None
        selected = editor.shown.selected
        with self._edits:
            labels = _labels(editor)
            if not labels:
                self._list.append(self._gui.add_markdown(NO_EDIT))
            for index, label in enumerate(labels):
                button = self._gui.add_button(label, color=None if index == selected else "gray")
                self._on_click(button, "select", index)
                self._list.append(button)
        self._values.visible = selected is not None
        if selected is not None:
            with self._values:
                self._build_card(editor, selected, names)

    def _build_card(self, editor: Editor, index: int, names: list[str]) -> None:
        gui, raw = self._gui, editor.raw(index)
        kind = raw["type"]
        name = self._name = gui.add_text("Name", raw.get("name") or LABELS[kind])

        @name.on_update
        async def _(event: Any) -> None:
            self._typed = None if event.client_id is None else event.target.value
            self._say("rename", event, index, event.target.value)

        enabled = gui.add_checkbox("On", raw.get("enabled", True))
        self._on_update(enabled, "enable", index)
        self._card += [name, enabled]
        for slider in _sliders(editor, raw):
            value = min(max(value_at(raw, slider), slider.low), slider.high)
            widget = gui.add_slider(slider.label, slider.low, slider.high, slider.step, value)
            self._on_update(widget, "slide", index, slider.path)
            self._sliders[slider.path] = widget
            self._card.append(widget)
        for path, options in CHOICES.get(kind, {}).items():
            value = raw.get(path)
            if value is None or value in options:
                choice = gui.add_dropdown(path.capitalize(), options, initial_value=value)
                self._on_update(choice, "set", index, path)
                self._card.append(choice)
        self._build_region(raw, index, names)
        order = gui.add_button_group("Order", ("Up", "Down", "Copy", "Delete"))
        self._on_choice(order, "order", index)
        self._card.append(order)
        self._build_handle(editor, kind)

    def _build_region(self, raw: dict[str, Any], index: int, names: list[str]) -> None:
        options = (EVERYWHERE, SELECTED, *names)
        if raw.get("region"):
            options = (_OWN, *options)
        where = self._gui.add_dropdown(
            "Acts in", options, initial_value=options[0], hint="Kept selections stand here, too"
        )

        @where.on_update
        async def _(event: Any) -> None:
            if event.target.value != _OWN:
                self._say("where", event, index, event.target.value)

        self._card.append(where)

    def _build_handle(self, editor: Editor, kind: str) -> None:
        number, handles, gui = editor.shown.handle, editor.handles, self._gui
        if number is None or number >= len(handles):
            return
        place, turn = _rounded(editor, handles[number])
        step = 10.0**-editor.digits
        label = "Centre" if kind in CENTRED else "Handle"
        self._place = gui.add_vector3(label, place, step=step, hint="Where it is, world units")
        self._on_update(self._place, "put")
        self._card.append(self._place)
        if kind in TURNING:
            self._turn = gui.add_vector3("Turned", turn, step=1.0, hint="Degrees about x, y, z")
            self._on_update(self._turn, "turn")
            self._card.append(self._turn)
        if kind == "anchors":
            away = gui.add_button("Take selected handle away", icon="x", color="gray")
            self._on_click(away, "remove_handle")
            self._card.append(away)


def _sliders(editor: Editor, raw: dict[str, Any]) -> list[Any]:
    """Sliders of an edit, in world units."""
    soft = [SOFT] if raw.get("region") else []
    size = size_of(editor.asset.points)
    return [one.scaled(size) for one in (*SLIDERS[raw["type"]], *soft)]


def _rows(editor: Editor) -> list[tuple[str, str | None, bool]]:
    """What the list says of every edit: kind, name, whether it acts."""
    entries = [raw_edit(entry) for entry in editor.session.stack.edits]
    return [(one["type"], one.get("name"), one.get("enabled", True)) for one in entries]


def _labels(editor: Editor) -> list[str]:
    """What the buttons of the list say."""
    return [
        f"{number} · {name or LABELS[kind]}{'' if enabled else ' (off)'}"
        for number, (kind, name, enabled) in enumerate(_rows(editor), start=1)
    ]


def _region(editor: Editor) -> Any:
    """What the card of the selected edit says of its region, without its soft edge."""
    region = dict((editor.present or {}).get("region") or {})
    return {key: value for key, value in region.items() if key != "falloff"}


def _held(editor: Editor) -> tuple[int | None, bool]:
    """The selected handle, and whether there is one."""
    number = editor.shown.handle
    return number, number is not None and number < len(editor.handles)


def _rounded(editor: Editor, handle: HandlePose) -> tuple[Any, Any]:
    """Place and angles of a handle as its fields show them; no number is -0."""
    place = tuple(round(one, editor.digits) + 0.0 for one in handle.place)
    return place, tuple(round(one, 2) + 0.0 for one in degrees_of(handle.turn))

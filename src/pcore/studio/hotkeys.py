"""Keys of the page: label, key, keys held with it, wish, and its values."""

from __future__ import annotations

from typing import Any

_FARTHER = 1.15
"""How many times as far handles reach after a key."""

HOTKEYS: tuple[tuple[Any, ...], ...] = (
    ("Undo", "Z", "cmd/ctrl", "undo"),
    ("Redo", "Z", "cmd/ctrl+shift", "redo"),
    ("Save", "S", "cmd/ctrl", "top", "Save"),
    ("Freeze selection", "H", None, "freeze"),
    ("Unfreeze everything", "H", "shift", "thaw"),
    ("Select with a box", "R", None, "tool", "box"),
    ("Select with a brush", "B", None, "tool", "brush"),
    ("Select with a lasso", "L", None, "tool", "lasso"),
    ("Select a ball on the surface", "G", None, "tool", "ball"),
    *((f"Only along {axis}", axis.upper(), None, "lock", axis) for axis in "xyz"),
    ("Arrows that move, alone", "1", None, "gizmo", "move"),
    ("Rings that turn, alone", "2", None, "gizmo", "turn"),
    ("Arrows that scale", "3", None, "gizmo", "scale"),
    ("Next handle begins another edit", "enter", None, "finish"),
    ("Next mirror", "M", None, "mirror"),
    ("Reach farther", "pageup", None, "reach", _FARTHER),
    ("Reach less far", "pagedown", None, "reach", 1 / _FARTHER),
    ("Key selected edit", "I", None, "key"),
    ("Play or pause", "space", None, "play"),
    ("A step later", "arrowright", None, "step", 1),
    ("A step earlier", "arrowleft", None, "step", -1),
    ("Next key", "arrowright", "shift", "jump", 1),
    ("Key before", "arrowleft", "shift", "jump", -1),
    ("Points or splats while moving", "P", None, "points"),
    ("Compare with before", "C", None, "before"),
    ("Dark or light panel", "T", None, "dark"),
    ("Next overlay", "O", None, "overlay"),
    ("Whole object", "F", None, "home"),
    ("Put a drag back", "escape", None, "cancel"),
    ("Put a stroke back", "escape", "shift", "cancel"),
    ("Take handle away", "delete", None, "remove_handle"),
    ("Keys and mouse", "K", None, "help"),
)

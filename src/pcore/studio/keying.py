"""Which numbers of an edit a key at a time keys, what they are, and what of an edit changed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.regions import FALLOFF
from pcore.editing.tracks import tracks_of
from pcore.studio.cage_handles import KINDS, moved_vertices
from pcore.studio.edit_forms import SLIDERS, SOFT, value_at

_MOVED = ("to", "rotation")


def keyed_values(raw: dict[str, Any], size: float) -> Iterator[tuple[str, Any]]:
    """Paths and values of all numbers that a page shows of an edit, and of its handles.

    Args:
        raw: the edit, without keyframes.
        size: of the object as it arrives at the edit, world units.
    """
    for number, handle in enumerate(raw.get("handles", ())):
        for name in _MOVED:
            if handle.get(name) is not None:
                yield f"handles/{number}/{name}", handle[name]
    if raw["type"] in KINDS and isinstance(raw["after"], list):
        for number in moved_vertices(raw):
            yield f"after/{number}", raw["after"][number]
    yield from _shown(raw, size).items()


def _shown(raw: dict[str, Any], size: float) -> dict[str, Any]:
    """Numbers of sliders; those of one vector together."""
    found = dict[str, Any]()
    for slider in SLIDERS[raw["type"]]:
        whole, _, last = slider.path.rpartition("/")
        if slider.path == "reach":  # What the edit takes by itself, to the last bit.
            found["reach"] = AnchorsEdit.reach_of(raw.get("reach"), size)
        elif last.isdecimal():
            found.setdefault(whole, []).append(value_at(raw, slider))
        else:
            found[slider.path] = value_at(raw, slider)
    region = raw.get("region")
    if isinstance(region, dict) and region.get("shape") != "mask":  # Masks fade by themselves.
        given = region.get("falloff")
        found[SOFT.path] = FALLOFF * size if given is None else given
    return found


def has_keys(raw: dict[str, Any], path: str) -> bool:
    """Whether a value, a list that it is in, or a number in it has keys."""
    around = (f"{one}/" for one in tracks_of(raw))
    return any(one.startswith(f"{path}/") or f"{path}/".startswith(one) for one in around)


def differences(old: Any, new: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Paths, old and new values of what is other in JSON values; lists of numbers are one."""
    if isinstance(new, dict):
        items = cast("dict[str, Any]", new).items()
        before = cast("dict[str, Any]", old) if isinstance(old, dict) else {}
        pairs = [(name, before.get(name), item) for name, item in items]
    elif (
        isinstance(new, list)
        and isinstance(old, list)
        and len(old) == len(new)
        and any(isinstance(one, (dict, list)) for one in new)
    ):
        lists = cast("list[Any]", old), cast("list[Any]", new)
        pairs = [(str(k), *both) for k, both in enumerate(zip(*lists, strict=True))]
    else:
        if old != new:
            yield path, old, new
        return
    for name, one, other in pairs:
        yield from differences(one, other, f"{path}/{name}" if path else name)

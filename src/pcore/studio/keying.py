"""Which numbers of an edit a key at a time keys, and what they are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.regions import FALLOFF
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

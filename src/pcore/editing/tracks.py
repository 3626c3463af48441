"""Numbers within the object of an edit by their path, and their keyframes."""

from __future__ import annotations

import copy
from typing import Any, cast

from pcore.editing.keyframes import at_time, check_track
from pcore.errors import EditError

Track = dict[str, Any]
"""`{"keyframes": [[time, value], ...], "easing": ...}` of an edit file."""


def tracks_of(raw: Any, path: str = "") -> dict[str, Track]:
    """All tracks within parsed JSON by their paths, such as "angle_deg" or "handles/0/to"."""
    if isinstance(raw, dict):
        items = cast("dict[str, Any]", raw)
        if "keyframes" in items:
            return {path: items}
        pairs = list(items.items())
    elif isinstance(raw, list):
        pairs = [(str(number), item) for number, item in enumerate(cast("list[Any]", raw))]
    else:
        return {}
    found: dict[str, Track] = {}
    for name, item in pairs:
        found |= tracks_of(item, f"{path}/{name}" if path else name)
    return found


def set_value(raw: dict[str, Any], path: str, value: Any) -> None:
    """Put a value at a path.

    Raises:
        EditError: there is no such place, or the value there has keyframes.
    """
    parent, name = _parent(raw, path)
    if _is_track(_item(parent, name, path)):
        raise EditError(
            f'"{path}": expected a value that stands still, got one with keyframes; set a key at a '
            "time, or take its keys away first"
        )
    parent[name] = value


def set_key(raw: dict[str, Any], path: str, time: float, value: Any, easing: str | None) -> None:
    """Make a value at a path have a key; one at the same time is replaced.

    Raises:
        EditError: there is no such place, or a key of another kind than the others.
    """
    parent, name = _parent(raw, path)
    old = _item(parent, name, path)
    track: Track = dict(old) if _is_track(old) else {"keyframes": []}
    keys = [key for key in track["keyframes"] if key[0] != time]
    track["keyframes"] = sorted([*keys, [time, value]], key=lambda key: key[0])
    if easing is not None:
        track["easing"] = easing
    check_track(track, str(name))
    parent[name] = track


def remove_key(raw: dict[str, Any], path: str, time: float) -> None:
    """Take a key away; with the last one the value stands still.

    Raises:
        EditError: there is no such key.
    """
    parent, name = _parent(raw, path)
    track = _item(parent, name, path)
    keys = track["keyframes"] if _is_track(track) else []
    left = [key for key in keys if key[0] != time]
    if len(left) == len(keys):
        times = ", ".join(f"{key[0]:g}" for key in keys) or "none"
        raise EditError(f'"{path}": expected the time of a key ({times}), got {time:g}')
    parent[name] = {**track, "keyframes": left} if left else keys[0][1]


def put_at(
    raw: dict[str, Any],
    path: str,
    time: float,
    value: Any,
    *,
    key: bool = False,
    easing: str | None = None,
) -> None:
    """Make a value be another at a time, and nothing else at any other key.

    Where it, a list that it is in, or a number in it has keys, those get one then.

    Args:
        raw: the edit.
        path: of the value.
        time: of the key.
        value: number or list of numbers.
        key: give it a key also where it has none; otherwise it is the same for all times then.
        easing: of all keys that are touched; None leaves it as it is.

    Raises:
        EditError: there is no such place, or a key of another kind than the others.
    """
    tracks = tracks_of(raw)
    holder = next((one for one in tracks if f"{path}/".startswith(f"{one}/")), None)
    if holder is not None and holder != path:
        name = holder.rpartition("/")[2]
        whole: Any = {name: copy.deepcopy(at_time({name: tracks[holder]}, time)[name])}
        set_value(whole, name + path.removeprefix(holder), value)
        set_key(raw, holder, time, whole[name], easing)
    elif isinstance(value, list) and any(one.startswith(f"{path}/") for one in tracks):
        for number, item in enumerate(cast("list[Any]", value)):
            put_at(raw, f"{path}/{number}", time, item, key=key, easing=easing)
    elif holder is not None or key:
        set_key(raw, path, time, value, easing)
    else:
        set_value(raw, path, value)


def _is_track(value: Any) -> bool:
    return isinstance(value, dict) and "keyframes" in value


def _item(parent: Any, name: Any, path: str) -> Any:
    """What stands at a place; nothing where a key of an object is not given."""
    if isinstance(parent, dict):
        return cast("dict[Any, Any]", parent).get(name)
    if isinstance(name, int) and 0 <= name < len(parent):
        return parent[name]
    raise EditError(f'"{path}": expected a place within the edit, such as "angle_deg", got none')


def _parent(raw: dict[str, Any], path: str) -> tuple[Any, Any]:
    """The object or list that holds a path's last name, and that name."""
    parent: Any = raw
    *above, last = path.split("/")
    for name in above:
        parent = _item(parent, _name(parent, name), path)
        if not isinstance(parent, (dict, list)) or _is_track(parent):
            raise EditError(f'"{path}": expected a place within the edit, got no "{name}" there')
    return parent, _name(parent, last)


def _name(parent: Any, name: str) -> Any:
    return int(name) if isinstance(parent, list) and name.isdecimal() else name

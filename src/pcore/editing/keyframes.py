"""Values that change over time, in place of numbers in an edit file."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any, cast

from pcore.errors import EditError

EASINGS: dict[str, Callable[[float], float]] = {
    "linear": lambda u: u,
    "smooth": lambda u: u * u * (3.0 - 2.0 * u),
    "in": lambda u: u * u,
    "out": lambda u: u * (2.0 - u),
    "step": lambda u: 0.0,
}
"""From the share of the time between two keys to the share of the way between their values."""

_SHAPE, _REST, _TURN = "after", "before", "rotation"
_FORM = '{"keyframes": [[time, value], ...], "easing": "smooth"}'


def is_animated(value: Any) -> bool:
    """Whether parsed JSON holds keyframes anywhere."""
    if isinstance(value, dict):
        items = cast("dict[str, Any]", value)
        return "keyframes" in items or any(map(is_animated, items.values()))
    if not isinstance(value, list) or set(map(type, cast("list[Any]", value))) == {float}:
        return False  # Most are places, by the thousand.
    return any(map(is_animated, cast("list[Any]", value)))


def key_times(value: Any) -> list[float]:
    """All times of keys in parsed JSON, in order, each once; checks every track.

    Raises:
        EditError: a track is not valid.
    """
    times: set[float] = set()

    def collect(track: dict[str, Any], name: str) -> Any:
        times.update(time for time, _ in _keys(track, name))
        return track

    _replaced(value, collect)
    return sorted(times)


def check_track(track: dict[str, Any], name: str) -> None:
    """Raise EditError where keyframes are not valid."""
    _keys(track, name)


def at_time(value: Any, time: float) -> Any:
    """Parsed JSON with every track replaced by its value at a time."""
    return _replaced(value, lambda track, name: _sample(track, name, time))


def _replaced(value: Any, change: Callable[[dict[str, Any], str], Any], name: str = "") -> Any:
    if isinstance(value, dict):
        items = cast("dict[str, Any]", value)
        if "keyframes" in items:
            return change(items, name)
        result: dict[str, Any] = {}
        for key, item in items.items():
            if key == _REST and is_animated(item):
                raise EditError(
                    f'key "{key}": expected a shape that stands still, got keyframes; animate how '
                    'much of the edit there is: "amount": {"keyframes": [[0, 0], [1, 1]]}, or '
                    '"after"'
                )
            try:
                result[key] = _replaced(item, change, key)
            except EditError as error:
                # The innermost key is what the message is about.
                inner = str(error).startswith('key "')
                raise EditError(str(error) if inner else f'key "{key}": {error}') from error
        return result
    if isinstance(value, list):
        return [_replaced(item, change) for item in cast("list[Any]", value)]
    return value


def _sample(track: dict[str, Any], name: str, time: float) -> Any:
    """Value of a track at a time; before the first and after the last key it stays."""
    keys = _keys(track, name)
    if time <= keys[0][0]:
        return keys[0][1]
    for (start, old), (end, new) in pairwise(keys):
        if time < end:
            share = EASINGS[track.get("easing", "linear")]((time - start) / (end - start))
            if name == _TURN:
                return _turned(old, new, share)
            return _between(old, new, share)
    return keys[-1][1]


def _turned(old: list[float], new: list[float], share: float) -> list[float]:
    """Unit quaternion a share of the way from one to another, the shorter way round (slerp)."""
    lengths = (math.hypot(*old) or 1.0), (math.hypot(*new) or 1.0)
    first, second = [x / lengths[0] for x in old], [x / lengths[1] for x in new]
    cosine = sum(a * b for a, b in zip(first, second, strict=True))
    sign = -1.0 if cosine < 0 else 1.0
    angle = math.acos(min(1.0, abs(cosine)))
    if math.sin(angle) < 1e-9:
        return first
    ends = math.sin((1 - share) * angle), sign * math.sin(share * angle)
    return [
        (ends[0] * a + ends[1] * b) / math.sin(angle) for a, b in zip(first, second, strict=True)
    ]


def _between(old: Any, new: Any, share: float) -> Any:
    if isinstance(old, str):
        return old if share == 0 else {"first": old, "second": new, "share": share}
    if isinstance(old, list):
        pairs = zip(cast("list[Any]", old), new, strict=True)
        return [_between(first, second, share) for first, second in pairs]
    return old + share * (new - old)


def _keys(track: dict[str, Any], name: str) -> list[tuple[float, Any]]:
    """Keys of a track, of the value with this name, as times and values.

    Raises:
        EditError: anything but increasing times with numbers, or lists of as many numbers each.
    """
    unknown = sorted(set(track) - {"keyframes", "easing"})
    if unknown:
        raise EditError(f'expected only "keyframes" and "easing" beside each other, got {unknown}')
    easing = track.get("easing", "linear")
    if not isinstance(easing, str) or easing not in EASINGS:
        names = ", ".join(f'"{name}"' for name in EASINGS)
        raise EditError(f'expected an "easing" that is one of {names}, got {easing!r}')
    raw = track["keyframes"]
    if not isinstance(raw, list) or not raw:
        raise EditError(f"expected keyframes {_FORM}, at least one, got {raw!r}")
    keys: list[tuple[float, Any]] = []
    for number, item in enumerate(cast("list[Any]", raw), start=1):
        pair: list[Any] = cast("list[Any]", item) if isinstance(item, list) else []
        if len(pair) != 2 or not _is_number(pair[0]) or _form(pair[1], name) is None:
            raise EditError(
                f"keyframe {number}: expected [time, value] with a finite time and a number or a "
                f"list of numbers, got {item!r}"
            )
        if keys and not pair[0] > keys[-1][0]:
            raise EditError(
                f"keyframe {number}: expected keyframes in order, each later than the one before, "
                f"got the time {pair[0]} after {keys[-1][0]}"
            )
        if keys and _form(pair[1], name) != _form(keys[0][1], name):
            raise EditError(
                f"keyframe {number}: expected a value of the same kind as the first, "
                f"{keys[0][1]!r}, got {pair[1]!r}"
            )
        keys.append((float(pair[0]), pair[1]))
    return keys


def _form(value: Any, name: str) -> tuple[int, ...] | str | None:
    """Lengths of lists of numbers, of lists of them in shapes; "file"; None for anything else."""
    if _is_number(value):
        return ()
    if name == _SHAPE and isinstance(value, str):
        return "file"
    if not isinstance(value, list) or not value:
        return None
    items = cast("list[Any]", value)
    inner = {_form(item, name) for item in items}
    form = inner.pop()
    if inner or not isinstance(form, tuple) or (form and name != _SHAPE):
        return None
    return (len(items), *form)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return math.isfinite(value)

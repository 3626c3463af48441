"""Edit files whose parameters change over time."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from pcore.editing.fields import FILE_KEYS, seen_from
from pcore.editing.keyframes import at_time, key_times
from pcore.editing.reading import read_edit_file, write_edit_file
from pcore.editing.script import EditScript, check_top, parse_edit
from pcore.errors import EditError
from pcore.validation import check_count


class Animation:
    """An edit script for every time; the times are those of its keyframes.

    Attributes:
        source: what messages call it, such as its file.
        key_times: times of all keys, in order, each once; empty where nothing is animated.
        start: time of the first key, 0 where nothing is animated.
        end: time of the last key.
    """

    def __init__(
        self, data: Any, *, source: str = "edit script", folder: Path | str | None = None
    ) -> None:
        """Check the content of an edit file with or without keyframes.

        Args:
            data: the object of the file.
            source: what messages call it.
            folder: where relative paths in it begin; None is the working directory.

        Raises:
            EditError: keyframes that are out of order or not numbers, or edits that are not valid
                at one of the keys.
        """
        content = check_top(data, source)
        self.source, self._folder = source, folder
        self._data = copy.deepcopy(content)
        self.key_times = self._checked_times()
        times = self.key_times or (0.0,)
        self.start, self.end = times[0], times[-1]
        for time in times:
            self.at(time)

    @property
    def content(self) -> dict[str, Any]:
        """The object of its edit file with absolute paths; a copy."""
        return self._seen_from(None)

    def at(self, time: float) -> EditScript:
        """The edits at a time; before the first and after the last key they stay as they are.

        Raises:
            EditError: a value between two keys is not valid, or the time is NaN or infinity.
        """
        if not math.isfinite(time):
            raise EditError(f"{self.source}: expected a finite time, got {time}")
        still = at_time(self._data, time)
        when = f" at time {time:g}" if self.key_times else ""
        return parse_edit(still, source=f"{self.source}{when}", folder=self._folder)

    def save(self, path: Path | str) -> None:
        """Write an edit file that means the same, keyframes included.

        Files in its folder and below are named as seen from it.

        Raises:
            EditError: the file cannot be written.
        """
        if not self.key_times:
            self.at(self.start).save(path)
            return
        # Only the names of files can have to change.
        moved = self._seen_from(Path(path).parent)
        write_edit_file(path, json.dumps(moved, indent=2) + "\n")

    def _seen_from(self, folder: Path | None) -> dict[str, Any]:
        """The object of its edit file, whose files are named as seen from a folder."""
        old = Path(self._folder or ".").absolute()
        return with_files(self._data, lambda name: seen_from(folder, str(old / name)))

    def times(self, frames: int) -> list[float]:
        """Times of so many frames, evenly from the first key to the last, both included.

        Raises:
            InputError: fewer than one frame.
        """
        check_count("frames", frames)
        return evenly(self.start, self.end, frames)

    def times_to_check(self, frames: int) -> list[float]:
        """Times of all keys and of so many frames, in order, each once; see `times`."""
        return sorted({*self.key_times, *self.times(frames)})

    def _checked_times(self) -> tuple[float, ...]:
        times: set[float] = set()
        for number, edit in enumerate(self._data["edits"], start=1):
            times.update(self._times_of(edit, f"{self.source}: edit {number}"))
        times.update(self._times_of(self._data.get("freeze", []), f"{self.source}: freeze"))
        return tuple(sorted(times))

    def _times_of(self, part: Any, place: str) -> list[float]:
        try:
            return key_times(part)
        except EditError as error:
            raise EditError(f"{place}: {error}") from error


def with_files(value: Any, change: Callable[[str], str], *, named: bool = False) -> Any:
    """Parsed JSON of edits or regions with the names of all its files changed; a copy.

    Args:
        value: the JSON.
        change: from one name to another.
        named: whether texts at the top, or in its keyframes, are names of files.
    """
    if isinstance(value, str):
        return change(value) if named else value
    if isinstance(value, list):
        return [with_files(item, change, named=named) for item in cast("list[Any]", value)]
    if not isinstance(value, dict):
        return value
    items = cast("dict[str, Any]", value)
    return {
        key: with_files(item, change, named=key in FILE_KEYS or (named and key == "keyframes"))
        for key, item in items.items()
    }


def evenly(start: float, end: float, frames: int) -> list[float]:
    """Times of so many frames, at least one, evenly from a time to another, both included."""
    if frames == 1:
        return [start]
    step = (end - start) / (frames - 1)
    return [start + step * number for number in range(frames - 1)] + [end]


def load_animation(path: Path | str) -> Animation:
    """Read an edit file with or without keyframes.

    Raises:
        EditError: as for `Animation`, or not a file in JSON.
    """
    path = Path(path)
    return Animation(read_edit_file(path), source=str(path), folder=path.parent)

"""Edit files whose parameters change over time."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

from pcore.editing.keyframes import at_time, is_animated, key_times
from pcore.editing.reading import read_edit_file
from pcore.editing.script import EditScript, check_top, parse_edit
from pcore.errors import EditError
from pcore.validation import check_count


class Animation:
    """An edit script for every time; the times are those of its keyframes.

    Attributes:
        source: what messages call it, such as its file.
        start: time of the first key, 0 where nothing is animated.
        end: time of the last key.
    """

    def __init__(self, data: Any, *, source: str, folder: Path | str | None = None) -> None:
        """Check parsed JSON at all its keys; see `parse_animation`."""
        content, version = check_top(data, source)
        if version == 1 and is_animated(content):
            raise EditError(f'{source}: keyframes need "version": 2, got 1')
        self.source, self._folder = source, folder
        self._data = copy.deepcopy(content)
        times = self._checked_times()
        self.start, self.end = (times[0], times[-1]) if times else (0.0, 0.0)
        for time in times or [0.0]:
            self.at(time)

    def at(self, time: float) -> EditScript:
        """The edits at a time; before the first and after the last key they stay as they are.

        Raises:
            EditError: a value between two keys is not valid.
        """
        still = at_time(self._data, time)
        return parse_edit(still, source=f"{self.source} at time {time:g}", folder=self._folder)

    def times(self, frames: int) -> list[float]:
        """Times of so many frames, evenly from the first key to the last, both included.

        Raises:
            InputError: fewer than one frame.
        """
        check_count("frames", frames)
        if frames == 1:
            return [self.start]
        step = (self.end - self.start) / (frames - 1)
        return [self.start + step * number for number in range(frames - 1)] + [self.end]

    def _checked_times(self) -> list[float]:
        times: set[float] = set()
        for number, edit in enumerate(self._data["edits"], start=1):
            times.update(self._times_of(edit, f"{self.source}: edit {number}"))
        times.update(self._times_of(self._data.get("freeze", []), f"{self.source}: freeze"))
        return sorted(times)

    def _times_of(self, part: Any, place: str) -> list[float]:
        try:
            return key_times(part)
        except EditError as error:
            raise EditError(f"{place}: {error}") from error


def load_animation(path: Path | str) -> Animation:
    """Read an edit file with or without keyframes.

    Raises:
        EditError: as for `parse_animation`, or not a file in JSON.
    """
    path = Path(path)
    return Animation(read_edit_file(path), source=str(path), folder=path.parent)


def parse_animation(
    data: Any, *, source: str = "edit script", folder: Path | str | None = None
) -> Animation:
    """Check the content of an edit file with or without keyframes.

    Args:
        data: the object of the file.
        source: what messages call it.
        folder: where relative paths in it begin; None is the working directory.

    Raises:
        EditError: keyframes that are out of order or not numbers, or edits that are not valid at
            one of the keys.
    """
    return Animation(data, source=source, folder=folder)

"""A film of an object that goes through its keyframes, made step by step."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pcore.asset.asset import Asset, Posed
from pcore.asset.content import LightName
from pcore.data.video import VideoWriter
from pcore.editing.animation import evenly
from pcore.editing.stack import Stack
from pcore.geometry.camera import Camera
from pcore.geometry.camera_path import path_at
from pcore.render.picture import RenderCancelledError
from pcore.studio.camera_keys import CameraKeys

_FPS = 24
_POSES = 0.1
"""Share of the time that it takes to move the object through all frames."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Film:
    """What is filmed; later edits do not change it.

    Attributes:
        asset: the object.
        stack: its edits.
        times: of the frames.
        cameras: one for every frame, or one for all.
        light: as `Asset.pose`.
        span: first and last time, where they are not those of the keyframes; else None.
    """

    asset: Asset
    stack: Stack
    times: tuple[float, ...]
    cameras: tuple[Camera, ...]
    light: LightName | None
    span: tuple[float, float] | None

    @classmethod
    def of(
        cls, asset: Asset, stack: Stack, keys: CameraKeys, count: int, *, light: LightName | None
    ) -> Film:
        """Plan a film of so many frames from the first key to the last, of edits and cameras.

        Args:
            asset: the object.
            stack: its edits.
            keys: cameras at their times, at least one; a single one stands still.
            count: of the frames.
            light: as `Asset.pose`.
        """
        edits = stack.animation
        ends = [edits.start, edits.end] if stack.animated else []
        ends += [time for time, _ in keys] if len(keys) > 1 else []
        start, end = min(ends, default=0.0), max(ends, default=0.0)
        times = evenly(start, end, count)
        own = not stack.animated or (start, end) == (edits.start, edits.end)
        cameras = path_at(keys, times) if len(keys) > 1 else [keys[0][1]]
        return cls(
            asset=asset,
            stack=stack,
            times=tuple(times),
            cameras=tuple(cameras),
            light=light,
            span=None if own else (start, end),
        )

    def line(self, run: Path, *, edit: Path, cameras: Path) -> str:
        """The command that makes the same film of the edits in a file."""
        words = ["pcore", "animate", str(run), "--edit", str(edit), "--frames"]
        words += [str(len(self.times)), "--fps", str(_FPS), "--cameras", str(cameras)]
        words += [] if self.span is None else ["--span", *map(repr, self.span)]
        words += ["--light", self.light] if self.light else []
        return shlex.join([*words, "-o", "OUT.mp4"])

    def write(self, path: Path, stopped: Callable[[], bool]) -> Iterator[float]:
        """Write it frame by frame, after each of which it says which share is done.

        Args:
            path: of the video; it appears at the end.
            stopped: asked at every step.

        Raises:
            RenderCancelledError: it was stopped.
            EditError: the edits fold space at one of the times.
        """
        posed: dict[float, Posed] = {}
        for number, time in enumerate(self._moments):
            _go_on(stopped)
            if time not in posed:
                posed[time] = self.asset.pose(self.stack.at(time), light=self.light)
                yield _POSES * number / len(self.times)
        frames = [posed[time] for time in self._moments]
        cameras = self.cameras if len(self.cameras) > 1 else self.cameras * len(frames)
        detail = self.asset.film_detail(frames, cameras)
        with VideoWriter(path, fps=_FPS) as video:
            for number, (one, camera) in enumerate(zip(frames, cameras, strict=True), start=1):
                _go_on(stopped)
                video.add(self.asset.render(one, camera, detail=detail, cancel=stopped).rgb)
                yield _POSES + (1 - _POSES) * number / len(frames)

    @property
    def _moments(self) -> list[float]:
        """Times of the edits, one for all where they stand still."""
        return [time if self.stack.animated else 0.0 for time in self.times]


def _go_on(stopped: Callable[[], bool]) -> None:
    if stopped():
        raise RenderCancelledError("film: it was stopped")

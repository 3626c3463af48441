"""Frames as an MP4 that browsers play."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import torch
from torch import Tensor, nn

from pcore.data.pictures import to_bytes
from pcore.data.whole_file import replacing
from pcore.errors import InputError
from pcore.packages import package
from pcore.validation import check_count

_QUALITY = "17"
"""H.264's constant rate factor: below 18 the loss is hard to see."""


def require_video() -> Any:
    """Return the module that encodes videos.

    Raises:
        DependencyError: it is not installed; call this before long work whose end is a video.
    """
    instead = "or write PNG files instead"
    return package("av", extra="video", need="videos need", instead=instead)


class VideoWriter:
    """Writes an MP4 (H.264, yuv420p, streamable) frame by frame. Use it in a `with` statement.

    The file appears when the block ends without an error; until then an old one stays. Odd sides
    are made even by repeating the last row or column, as the format demands.
    """

    def __init__(self, path: Path, *, fps: int = 30) -> None:
        """Prepare a video of `fps` frames per second.

        Raises:
            DependencyError: the package `av` (extra `video`) is missing.
        """
        self._av = require_video()
        self._path, self._fps = path, check_count("video: fps", fps)
        self._shape: torch.Size | None = None
        self._stream: Any | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            # Moving the index to the front reads the file again: memory alone would not do.
            partial = stack.enter_context(replacing(self._path))
            options = {"movflags": "faststart"}
            self._container = stack.enter_context(
                self._av.open(partial, "w", format="mp4", options=options)
            )
            self._stack = stack.pop_all()
        return self

    def add(self, frame: Tensor) -> None:
        """Append colours (H, W, 3), float in [0, 1] (clamped) or uint8; InputError when misfit."""
        stream = self._begin(frame) if self._stream is None else self._stream
        if frame.shape != self._shape:
            raise InputError(
                f"{self._path}: expected frames of one size, got {tuple(frame.shape)} after "
                f"{tuple(self._shape or ())}"
            )
        image = self._av.VideoFrame.from_ndarray(_pixels(frame), format="rgb24")
        self._container.mux(stream.encode(image))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            if self._stream is None:
                raise InputError(f"{self._path}: expected at least one frame for a video, got none")
            self._container.mux(self._stream.encode(None))

    def _begin(self, frame: Tensor) -> Any:
        if frame.ndim != 3 or frame.shape[2] != 3 or min(frame.shape) < 1:
            raise InputError(f"{self._path}: expected frames (H, W, 3), got {tuple(frame.shape)}")
        self._shape = frame.shape
        stream = self._container.add_stream("libx264", rate=self._fps, options={"crf": _QUALITY})
        stream.height, stream.width = _even(frame.shape[0]), _even(frame.shape[1])
        stream.pix_fmt = "yuv420p"
        self._stream = stream
        return stream


def write_video(path: Path, frames: Iterable[Tensor], *, fps: int = 30) -> int:
    """Write frames (H, W, 3) as an MP4 and return their number; see `VideoWriter`."""
    count = 0
    with VideoWriter(path, fps=fps) as video:
        for frame in frames:
            video.add(frame)
            count += 1
    return count


def _pixels(frame: Tensor) -> Any:
    pixels = frame.cpu() if frame.dtype == torch.uint8 else to_bytes(frame)
    rows, columns = _even(frame.shape[0]) - frame.shape[0], _even(frame.shape[1]) - frame.shape[1]
    if rows or columns:
        planes = pixels.permute(2, 0, 1).unsqueeze(0).float()
        planes = nn.functional.pad(planes, (0, columns, 0, rows), mode="replicate")
        pixels = planes[0].permute(1, 2, 0).to(torch.uint8)
    return pixels.contiguous().numpy()


def _even(side: int) -> int:
    return side + side % 2

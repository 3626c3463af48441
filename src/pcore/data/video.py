"""Frames as an MP4 that browsers play."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pcore.data.pictures import replacing, to_bytes
from pcore.errors import DependencyError, InputError
from pcore.validation import check_count

_QUALITY = "17"
"""H.264's constant rate factor: below 18 the loss is hard to see."""


def require_video() -> Any:
    """Return the module that encodes videos.

    Raises:
        DependencyError: it is not installed; call this before long work whose end is a video.
    """
    try:
        import av
    except ImportError as error:
        raise DependencyError(
            "writing videos needs the package av, which is not installed: "
            "`pip install 'pcore-edit[video]'`, or write PNG files instead"
        ) from error
    return av


def write_video(path: Path, frames: Iterable[Tensor], *, fps: int = 30) -> int:
    """Write an MP4 (H.264, yuv420p, streamable) and return its number of frames.

    Odd sides are made even by repeating the last row or column, as the format demands.

    Args:
        path: where to; replaced whole.
        frames: colours (H, W, 3), all of one size, float in [0, 1] (clamped) or uint8.
        fps: frames per second.

    Raises:
        DependencyError: the package `av` (extra `video`) is missing.
        InputError: no frames, or frames of another size or shape.
        OSError: the file cannot be written; an old one is untouched.
    """
    av = require_video()
    check_count("video: fps", fps)
    # Moving the index to the front reads the file again: it cannot be written to memory.
    with replacing(path) as partial:
        with av.open(partial, "w", format="mp4", options={"movflags": "faststart"}) as container:
            return _encode(av, container, path, frames, fps)


def _encode(av: Any, container: Any, path: Path, frames: Iterable[Tensor], fps: int) -> int:
    count, shape, stream = 0, None, None
    for frame in frames:
        if stream is None:
            _check_shape(path, frame)
            shape, stream = frame.shape, _stream(container, frame, fps)
        if frame.shape != shape:
            raise InputError(
                f"{path}: expected frames of one size, got {tuple(frame.shape)} after "
                f"{tuple(shape or ())}"
            )
        container.mux(stream.encode(av.VideoFrame.from_ndarray(_pixels(frame), format="rgb24")))
        count += 1
    if stream is None:
        raise InputError(f"{path}: expected at least one frame for a video, got none")
    container.mux(stream.encode(None))
    return count


def _stream(container: Any, frame: Tensor, fps: int) -> Any:
    stream = container.add_stream("libx264", rate=fps, options={"crf": _QUALITY})
    stream.height, stream.width = _even(frame.shape[0]), _even(frame.shape[1])
    stream.pix_fmt = "yuv420p"
    return stream


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


def _check_shape(path: Path, frame: Tensor) -> None:
    if frame.ndim != 3 or frame.shape[2] != 3 or min(frame.shape) < 1:
        raise InputError(f"{path}: expected frames (H, W, 3), got {tuple(frame.shape)}")

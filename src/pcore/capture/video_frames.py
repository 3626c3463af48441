"""Sharp frames of a video, evenly over its length."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pcore.data.video import require_video
from pcore.errors import SceneError

_FRAMES = 120
"""Frames that a video is read as: enough around an object, few enough to match all pairs."""
_LEAST = 3


def choose_frames(path: Path, folder: Path, tell: Callable[[str], None]) -> None:
    """Write the sharpest frame of each of up to 120 equal parts of a video as JPEG.

    Args:
        path: the video.
        folder: where to; is made.
        tell: called with a line of progress.

    Raises:
        SceneError: no video, or one with too few frames.
        DependencyError: `av` (extra `video`) is not installed.
    """
    av = require_video()
    folder.mkdir(parents=True)
    try:
        with av.open(str(path)) as container:
            total = sum(1 for _ in container.decode(video=0))
        if total < _LEAST:
            raise SceneError(
                f"video {path}: expected at least {_LEAST} frames, got {total}; is it cut short?"
            )
        tell(f"choosing frames of {total}")
        with av.open(str(path)) as container:
            best, part = (-1.0, None), 0
            for index, frame in enumerate(container.decode(video=0)):
                # Phones store frames as the sensor lies, and how they are to be turned.
                pixels = np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90))
                here = index * min(_FRAMES, total) // total
                if here > part:
                    _save(best[1], folder, part)
                    best, part = (-1.0, None), here
                sharp = _sharpness(pixels)
                if sharp > best[0]:
                    best = (sharp, pixels)
            _save(best[1], folder, part)
    except (av.FFmpegError, IndexError, ValueError) as problem:
        raise SceneError(
            f"video {path}: expected a video with frames, got one that cannot be decoded "
            f"({problem}); export it again as MP4"
        ) from problem


def _save(pixels: NDArray[np.uint8] | None, folder: Path, number: int) -> None:
    assert pixels is not None, "every part has a frame"
    Image.fromarray(pixels).save(folder / f"{number:04d}.jpg", quality=95)


def _sharpness(pixels: NDArray[np.uint8]) -> float:
    """Variance of the second differences of the brightness: lower where a frame is blurred."""
    grey = pixels[::2, ::2].mean(axis=-1)
    second = (
        grey[1:-1, 2:] + grey[1:-1, :-2] + grey[2:, 1:-1] + grey[:-2, 1:-1] - 4 * grey[1:-1, 1:-1]
    )
    return float(second.var())

"""Sharp frames of a video, evenly over its length."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import percentile_filter

from pcore.data.video import require_video
from pcore.errors import SceneError

_FRAMES = 120
"""Frames that a video is read as: enough around an object, few enough to match all pairs."""
_LEAST = 3
_THUMB = 16
"""Side of the small pictures that cuts are found in: large enough to tell places apart."""
_CUT, _SUDDEN = 0.08, 4.0
"""A cut changes the small pictures by so much of their range for good, and by so many times what
four of five frames around it change by: fast pans change all of them."""
_AROUND = 25
"""Frames around a change that are compared with it."""


def choose_frames(path: Path, folder: Path, tell: Callable[[str], None]) -> str:
    """Write the sharpest frame of each of up to 120 equal parts of a video as JPEG.

    Of a video that was cut together of several scenes the longest one is taken.

    Args:
        path: the video.
        folder: where to; is made.
        tell: called with a line of progress.

    Returns:
        What was left out, or "".

    Raises:
        SceneError: no video, or one with too few frames.
        DependencyError: `av` (extra `video`) is not installed.
    """
    av = require_video()
    folder.mkdir(parents=True)
    try:
        with av.open(str(path)) as container:
            small = [_thumb(frame) for frame in container.decode(video=0)]
        scenes = scenes_of(small)
        first, end = max(scenes, key=lambda scene: scene[1] - scene[0], default=(0, 0))
        if end - first < _LEAST:
            raise SceneError(
                f"video {path}: expected at least {_LEAST} frames of one scene, got {end - first}"
                f"{f' in the longest of {len(scenes)} scenes' if len(scenes) > 1 else ''}; is it "
                "cut short?"
            )
        note = ""
        if len(scenes) > 1:
            note = (
                f"{path.name} shows {len(scenes)} scenes, with a cut between them: the longest "
                f"one is used, frames {first} to {end - 1} of {len(small)}"
            )
            tell(note)
        tell(f"choosing frames of {end - first}")
        with av.open(str(path)) as container:
            _write_sharpest(islice(container.decode(video=0), first, end), end - first, folder)
    except (av.FFmpegError, IndexError, ValueError) as problem:
        raise SceneError(
            f"video {path}: expected a video with frames, got one that cannot be decoded "
            f"({problem}); export it again as MP4"
        ) from problem
    return note


def scenes_of(small: Sequence[NDArray[np.uint8]]) -> list[tuple[int, int]]:
    """First frames of the scenes of a video, and those after their last ones.

    Args:
        small: pictures (H, W, 3) of all frames.
    """
    if len(small) < 2:
        return [(0, len(small))] if small else []
    pictures = np.stack(small).astype(np.float32) / 255
    steps = np.abs(pictures[1:] - pictures[:-1]).mean(axis=(1, 2, 3))
    usual = percentile_filter(steps, 80, size=_AROUND, mode="nearest")
    places = np.arange(1, len(small))
    # A flash of one frame is there and gone: the next but one is like the last.
    later, earlier = np.minimum(places + 1, len(small) - 1), np.maximum(places - 2, 0)
    stays = np.abs(pictures[later] - pictures[earlier]).mean(axis=(1, 2, 3))
    cuts = places[np.minimum(steps, stays) > np.maximum(_CUT, _SUDDEN * usual)].tolist()
    return list(pairwise([0, *cuts, len(small)]))


def _thumb(frame: Any) -> NDArray[np.uint8]:
    small = frame.reformat(width=_THUMB, height=_THUMB, format="rgb24", interpolation="AREA")
    return small.to_ndarray()


def _write_sharpest(frames: Iterable[Any], total: int, folder: Path) -> None:
    """Write the sharpest one of each part of so many frames."""
    best, part = (-1.0, None), 0
    for index, frame in enumerate(frames):
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

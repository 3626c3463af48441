"""Pictures that end too early: copies that were broken off, full disks."""

from __future__ import annotations

import os
from pathlib import Path

from PIL import Image

from pcore.data.image_files import ImageHeader, read_header
from pcore.errors import SceneError

_TAIL = 4096
_JPEG_END = b"\xff\xd9"


def check_whole(path: Path) -> None:
    """Find a picture that ends in its middle, decoding as few pixels as that takes.

    A JPEG whose last bytes are its end mark is whole; the chunks of a PNG carry checksums. All
    others, and JPEGs that something was appended to, are decoded. HEIC is left to its decoder.

    Args:
        path: a picture whose header can be read.

    Raises:
        SceneError: it is cut off, or its checksums are wrong.
    """
    try:
        with Image.open(path) as image:
            if image.format == "JPEG" and _tail(path).endswith(_JPEG_END):
                return
            if image.format == "PNG":
                image.verify()
            elif image.format not in ("HEIF", "AVIF"):
                image.load()
    except (OSError, SyntaxError, ValueError, EOFError) as problem:
        raise SceneError(
            f"image {path}: cut off or damaged ({problem}); copy or export it again"
        ) from problem


def why_unreadable(path: Path) -> str | None:
    """Why a picture cannot be used, to be read after its name; None of a whole one."""
    found = header_of_whole(path)
    return found if isinstance(found, str) else None


def header_of_whole(path: Path) -> ImageHeader | str:
    """The header of a whole picture; of another one why it cannot be used, as `why_unreadable`."""
    try:
        header = read_header(path)
        check_whole(path)
    except SceneError as problem:
        return str(problem).removeprefix(f"image {path}: ")
    return header


def _tail(path: Path) -> bytes:
    """The last bytes of a file, without zeros that some cameras pad with."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _TAIL), os.SEEK_SET)
        return file.read().rstrip(b"\0")

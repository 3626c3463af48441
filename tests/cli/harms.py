"""Ways to harm the files of a small world, as people and disks do."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

Harm = Callable[[Path], object]
EDIT = {"type": "twist", "axis": "z", "angle_deg": 30}


def text(path: str, content: str | bytes) -> Harm:
    """Put a file in place."""
    data = content.encode() if isinstance(content, str) else content
    return lambda world: (world / path).write_bytes(data)


def cut(path: str, keep: float = 0.6) -> Harm:
    """Truncate a file."""

    def harm(world: Path) -> None:
        data = (world / path).read_bytes()
        (world / path).write_bytes(data[: int(keep * len(data))])

    return harm


def gone(path: str) -> Harm:
    """Delete a file or folder."""

    def harm(world: Path) -> None:
        target = world / path
        shutil.rmtree(target) if target.is_dir() else target.unlink()

    return harm


def folder(path: str) -> Harm:
    """Put a folder with one file in place."""

    def harm(world: Path) -> None:
        (world / path).mkdir()
        (world / path / "mine.txt").write_text("mine")

    return harm


def keys(path: str, **changes: Any) -> Harm:
    """Set keys of a JSON file."""

    def harm(world: Path) -> None:
        content = json.loads((world / path).read_text())
        (world / path).write_text(json.dumps({**content, **changes}))

    return harm


def frame(**changes: Any) -> Harm:
    """Set keys of the second training frame."""

    def harm(world: Path) -> None:
        path = world / "ball" / "transforms_train.json"
        content = json.loads(path.read_text())
        content["frames"][1].update(changes)
        path.write_text(json.dumps(content))

    return harm


def edit(content: object) -> Harm:
    """Replace the list of edits; other values than lists replace the file."""
    whole = {"version": 2, "edits": content} if isinstance(content, list) else content
    return lambda world: (world / "edit.json").write_text(json.dumps(whole))


def array(path: str, value: Any) -> Harm:
    """Save a NumPy file."""
    return lambda world: np.save(world / path, value, allow_pickle=True)


def image(path: str, size: int = 16, mode: str = "RGBA") -> Harm:
    """Put an image in place."""
    return lambda world: Image.new(mode, (size, size)).save(world / path)


def frames(count: int) -> Harm:
    """Keep so many training frames."""

    def harm(world: Path) -> None:
        path = world / "ball" / "transforms_train.json"
        content = json.loads(path.read_text())
        path.write_text(json.dumps({**content, "frames": content["frames"][:count]}))

    return harm


def transparent(world: Path) -> None:
    """Training images without any object."""
    for path in (world / "ball" / "train").iterdir():
        Image.new("RGBA", (16, 16)).save(path)


def strange_demo(world: Path) -> None:
    """A folder with a file of the name that demos use."""
    folder("mine")(world)
    text("mine/demo.json", "{}")(world)


class Trap:
    """Would make a file if a pickle of it were executed."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("executed"),))

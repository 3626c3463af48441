"""Files that a page writes, all of them in one folder of the run: edits, pictures, films."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcore.asset.asset import Asset, Posed
from pcore.data.pictures import write_png
from pcore.editing.autosave import write_session
from pcore.editing.session import EditSession
from pcore.errors import InputError
from pcore.files.atomic import write_atomically
from pcore.geometry.camera import Camera
from pcore.studio.guard import is_file_name

AUTOSAVE = "autosave.json"
_SPARED = "autosave"
_OWN = re.compile(r"autosave.*|.*\.cameras\.json|(picture|film)_\d+\.json", re.IGNORECASE)
"""Names that this page gives to files of its own; capital letters are no difference."""


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Where a page may write.

    Attributes:
        folder: of pictures, films and the autosave; made when first needed.
        edit: the edit file that it saves.
        run: of the object, for command lines.
    """

    folder: Path
    edit: Path
    run: Path

    def __post_init__(self) -> None:
        """Raise InputError where the edit file is one that the page writes for itself."""
        if self.edit.parent.resolve() == self.folder.resolve():
            _refuse_own(self.edit.name)

    def named(self, name: str, ending: str) -> Path:
        """Return a file beside the edit file, or that one, by the name that a page gives.

        Raises:
            InputError: the name has folders in it or another ending, or is one that the page gives
                to files of its own.
        """
        if name == self.edit.name:  # Whoever started the page named it, in letters of any kind.
            return self.edit
        if not is_file_name(name) or not name.endswith(ending):
            raise InputError(
                f"name of a file: expected letters, numbers and - _ . that end in {ending}, got "
                f"{name!r}"
            )
        _refuse_own(name)
        return self.edit.parent / name

    def next(self, stem: str, ending: str) -> Path:
        """Return a file in the folder that is not there yet, such as picture_002.png."""
        self.folder.mkdir(parents=True, exist_ok=True)
        numbers = range(1, 100_000)
        paths = (self.folder / f"{stem}_{number:03}{ending}" for number in numbers)
        return next(path for path in paths if not path.exists())

    @property
    def autosave(self) -> Path:
        """The file that keeps what is not saved."""
        return self.folder / AUTOSAVE

    def keep(self, session: EditSession, cameras: Sequence[dict[str, Any]]) -> None:
        """Write the autosave, with the history and the camera keys.

        Raises:
            EditError: it cannot be written; an old one stays as it is.
            OSError: its folder cannot be made.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        write_session(self.autosave, session, {"cameras": list(cameras)})

    def spare(self) -> Path | None:
        """Move an autosave that is newer than the edit file aside; return where, if there is one.

        Raises:
            OSError: it cannot be moved.
        """
        if not self.left_over:
            return None
        return self.autosave.rename(self.next(_SPARED, ".json"))

    def is_spared(self, name: str) -> bool:
        """Whether a name is one of an autosave that was moved aside."""
        number = name.removeprefix(f"{_SPARED}_").removesuffix(".json")
        return name == f"{_SPARED}_{number}.json" and number.isdecimal()

    def forget(self) -> None:
        """Remove the autosave: everything in it is saved, or not wanted."""
        self.autosave.unlink(missing_ok=True)

    @property
    def left_over(self) -> bool:
        """Whether there is an autosave that is newer than the edit file."""
        try:
            kept = self.autosave.stat().st_mtime
            return not self.edit.is_file() or kept > self.edit.stat().st_mtime
        except OSError:
            return False

    def line(
        self, picture: str, cameras: Path, *, edit: Path | None, time: float, light: str | None
    ) -> str:
        """The command that makes the same picture of the edits in a file, or of none."""
        words = ["pcore", "render", str(self.run)]
        words += ["--edit", str(edit), "--time", repr(time)] if edit else []
        words += ["--cameras", str(cameras)]
        words += ["--light", light] if light else []
        return shlex.join([*words, "-o", picture])


def _refuse_own(name: str) -> None:
    if _OWN.fullmatch(name):
        raise InputError(
            f"name of a file: {name} is one that the studio keeps for itself (autosaves, cameras, "
            "pictures and films); take another, such as pose.json"
        )


def camera_frame(camera: Camera) -> dict[str, Any]:
    """A camera as a frame of a transforms file."""
    focal = camera.focal
    return {
        "transform_matrix": camera.world_from_camera.tolist(),
        "w": camera.width,
        "h": camera.height,
        "fl_x": focal[0],
        "fl_y": focal[1],
        "cx": float(camera.cx),
        "cy": float(camera.cy),
    }


def write_cameras(path: Path, cameras: Sequence[Camera]) -> None:
    """Write cameras as a transforms file."""
    frames = [
        {"file_path": f"frame_{number:04}", **camera_frame(camera)}
        for number, camera in enumerate(cameras)
    ]
    write_atomically(path, json.dumps({"frames": frames}, indent=1).encode())


def write_picture(
    outputs: Outputs, asset: Asset, posed: Posed, camera: Camera
) -> tuple[Path, Path]:
    """Write an exact picture and the cameras file that makes it again; return both paths."""
    path = outputs.next("picture", ".png")
    cameras = path.with_suffix(".json")
    write_png(path, asset.render(posed, camera).rgb)
    write_cameras(cameras, [camera])
    return path, cameras

"""Pictures by the user's own pcore, as a process of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

from .bundle import BridgeError, Bundle

LOG = "pcore.log"


def command_of(
    bundle: Bundle, program: str, run: str, edit: str, cameras: str, frames: Path, fps: int
) -> list[str]:
    """Return the arguments that render an edit file, one picture for every frame.

    Args:
        bundle: where the edit file and cameras lie.
        program: the user's `pcore`: a path, or a name on the path of programs.
        run: folder of the run; empty takes the one the bundle names.
        edit: name of the edit file.
        cameras: name of the file of the camera's path; empty takes those of the run.
        frames: folder for the pictures.
        fps: frames per second.

    Raises:
        BridgeError: no such program, run or file, or an edit that does not move.
    """
    found = shutil.which(program)
    if found is None:
        raise BridgeError(f"{program!r}: no such program; set the path of pcore in the preferences")
    named = bundle.about.get("run_folder")
    folder = Path(run) if run else bundle.folder / (named or "")
    if (not run and not named) or not folder.is_dir():
        raise BridgeError(f"{folder}: no such folder of a run; choose it")
    files = [bundle.folder / name for name in (edit, cameras) if name]
    for file in files:
        if not file.is_file():
            raise BridgeError(f"{file}: no such file; export it first")
    count = 1 + round((_length(files[0])) * fps)
    words = [found, "animate", str(folder.resolve()), "--edit", str(files[0])]
    words += ["--frames", str(count), "--fps", str(fps)]
    words += ["--frames-dir", str(frames), "--overwrite"]
    return words if not cameras else [*words, "--cameras", str(files[1])]


def start(words: list[str], folder: Path) -> subprocess.Popen:
    """Start it without a shell; what it says goes into a file in the folder of the bundle."""
    with (folder / LOG).open("wb") as log:
        return subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
        )


def last_words(folder: Path) -> str:
    """Return the last line that it said."""
    text = (folder / LOG).read_text(encoding="utf-8", errors="replace").strip()
    return text.splitlines()[-1] if text else "it said nothing"


def _length(edit: Path) -> float:
    """Time from the first key of an edit file to the last."""
    times = sorted(_times(json.loads(edit.read_text(encoding="utf-8"))))
    if not times or times[-1] <= times[0]:
        raise BridgeError(f"{edit}: nothing moves in it; export it with all frames")
    return times[-1] - times[0]


def _times(content: object) -> list[float]:
    if isinstance(content, dict):
        own = [key[0] for key in content.get("keyframes", ())]
        return own + [time for item in content.values() for time in _times(item)]
    if isinstance(content, list):
        return [time for item in content for time in _times(item)]
    return []

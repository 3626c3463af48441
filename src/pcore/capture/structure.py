"""Poses for photos and videos that have none: structure from motion by COLMAP, in a child process.

The child is another Python: COLMAP's library and Pillow crash one another in one process, and one
that hangs can be ended. Models, and frames of videos, are kept in the user's cache.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcore.capture.colmap import find_model
from pcore.capture.layouts import PHOTOS, Layout
from pcore.capture.photos import pictures_in
from pcore.capture.video_frames import choose_frames
from pcore.errors import DependencyError, SceneError

Tell = Callable[[str], None]
"""Called with a line of progress."""
CHILD = (sys.executable, "-m", "pcore.capture.structure_child")
_SAID = "pcore: "
"""How lines of the child begin that are for the user."""
_LEAST = 3


@dataclass(frozen=True, kw_only=True)
class Patience:
    """How long a reconstruction may take, seconds.

    Attributes:
        whole: all of it.
        silence: without a line of the child.
    """

    whole: float = 7200.0
    silence: float = 900.0


def with_poses(layout: Layout, tell: Tell, patience: Patience | None = None) -> Layout:
    """Pose photos, or frames of a video; the same files are posed once.

    Returns:
        The layout of the model in the cache, with the photos where they are.

    Raises:
        SceneError: too few photos, no common structure, or a child that hung or crashed.
        DependencyError: pycolmap (extra `colmap`) is not installed.
    """
    video = layout.name != PHOTOS
    sources = [layout.path] if video else pictures_in(layout.path)
    place = cache_folder() / _key(sources)
    if not place.is_dir():
        if importlib.util.find_spec("pycolmap") is None:
            raise DependencyError(
                f"scene {layout.root}: holds photos without poses; finding them needs pycolmap, "
                "which is not installed: `pip install 'pcore-edit[colmap]'`, or pose the photos "
                "with COLMAP and put its model into sparse/0"
            )
        if not video and len(sources) < _LEAST:
            raise SceneError(
                f"scene {layout.root}: expected at least {_LEAST} photos to find poses for, got "
                f"{len(sources)}"
            )
        _reconstruct(layout, place, tell, patience or Patience())
    found = find_model(place)
    if found is None:
        raise SceneError(f"{place}: expected the model of {layout.path}; remove this folder")
    root = place if video else layout.path
    return Layout(name="COLMAP", root=root, path=found.folder, note=found.note)


def cache_folder() -> Path:
    """Where models and frames are kept: $XDG_CACHE_HOME or ~/.cache, then pcore/structure."""
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "pcore" / "structure"


def _key(sources: Sequence[Path]) -> str:
    """Name of the same files: their places, sizes and times."""
    digest = hashlib.sha256()
    for path in sources:
        state = path.stat()
        digest.update(f"{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:24]


def _reconstruct(layout: Layout, place: Path, tell: Tell, patience: Patience) -> None:
    """Make the model in a folder beside its place and move it there when it is whole."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=place.parent, prefix="unfinished-") as made:
        work = Path(made)
        images = layout.path
        if layout.name != PHOTOS:
            images = work / "images"
            choose_frames(layout.path, images, tell)
        names = [path.name for path in pictures_in(images)]
        wish = {
            "images": str(images.resolve()),
            "names": names,
            "output": str(work / "sparse"),
            "database": str(work / "database.db"),
            "ordered": layout.name != PHOTOS,
        }
        _run(wish, tell, patience, str(layout.path))
        (work / "database.db").unlink(missing_ok=True)
        model = find_model(work)
        if model is None:
            raise SceneError(
                f"scene {layout.path}: COLMAP found no common structure in {len(names)} photos; "
                "take them closer together, sharp, with texture around the object"
            )
        shutil.copytree(work, place)


@dataclass(kw_only=True)
class _Watch:
    """Ends a child that takes too long, or says nothing for too long.

    Attributes:
        child: the process.
        patience: how long it may take.
        heard: time of its last line, seconds of the monotonic clock.
        late: why it was ended; empty while it was not.
    """

    child: subprocess.Popen[str]
    patience: Patience
    heard: float
    late: str = ""

    def __call__(self) -> None:
        """Look at the clock until the child ends."""
        began = self.heard
        while self.child.poll() is None:
            now = time.monotonic()
            if now - began > self.patience.whole:
                self.late = f"after {self.patience.whole:g} s"
            elif now - self.heard > self.patience.silence:
                self.late = f"after {self.patience.silence:g} s in which it said nothing"
            if self.late:
                self.child.kill()  # SIGTERM is not enough: a crashed COLMAP ignores it.
                return
            time.sleep(0.1)


def _run(wish: Mapping[str, object], tell: Tell, patience: Patience, where: str) -> None:
    """Run the child to its end, or end it."""
    tail: deque[str] = deque(maxlen=8)
    with subprocess.Popen(
        [*CHILD, json.dumps(wish)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        errors="replace",
    ) as child:
        watch = _Watch(child=child, patience=patience, heard=time.monotonic())
        threading.Thread(target=watch, daemon=True).start()
        try:
            assert child.stdout is not None, "it was asked for"
            for line in child.stdout:
                watch.heard = time.monotonic()
                if line.startswith(_SAID):
                    tell(line.removeprefix(_SAID).rstrip())
                else:
                    tail.append(line.rstrip())
            child.wait()
        except BaseException:
            child.kill()
            raise
    if watch.late:
        raise SceneError(
            f"scene {where}: COLMAP was ended {watch.late}; give fewer or smaller photos, or pose "
            "them with COLMAP itself and put the model into sparse/0"
        )
    if child.returncode != 0:
        said = " | ".join(line for line in tail if line)[-400:]
        raise SceneError(
            f"scene {where}: COLMAP ended with code {child.returncode} and found no poses; it "
            f"said: {said or 'nothing'}"
        )

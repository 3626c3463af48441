"""What a page saves, opens, photographs and films."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from pcore.editing.animation import load_animation
from pcore.editing.autosave import read_session
from pcore.errors import EditError, InputError, PcoreError
from pcore.geometry.camera import Camera
from pcore.render.picture import RenderCancelledError
from pcore.studio.camera_keys import frames_of, keys_of, read_keys, write_keys
from pcore.studio.filming import Film
from pcore.studio.guard import plain
from pcore.studio.mesh_files import MeshFiles
from pcore.studio.outputs import write_cameras, write_picture
from pcore.studio.viewport import Viewport

if TYPE_CHECKING:
    from pcore.studio.studio import Studio

_LARGEST = 4096
_MOST_FRAMES = 2000
_EVERY = 2.0
"""Seconds between two autosaves, at least."""


class StudioFiles:
    """Files of a page, and the camera keys that films go through."""

    def __init__(self, studio: Studio) -> None:
        """Begin with nothing to save.

        Args:
            studio: whose editor is saved.
        """
        self._studio = studio
        self.cameras = read_keys(studio.outputs.edit)
        self._filming = False
        self.saved, self.line = True, ""
        self.edit = studio.outputs.edit
        self._kept, self._written = False, -_EVERY
        self._later: threading.Timer | None = None
        self._stopped = threading.Event()
        self._seen = self._number
        self._meshes = MeshFiles(studio.outputs.folder)

    @property
    def _number(self) -> int:
        return self._studio.editor.session.history.present.number

    def note(self) -> None:
        """Where edits changed: keep them, and what is in their files."""
        self._meshes.see(self._studio.editor.session.stack)
        if self._number != self._seen:
            self._seen = self._number
            self.autosave()

    def autosave(self) -> None:
        """Keep what would be lost, soon; a full disk is said and ends nothing."""
        self.saved = False
        late = self._written + _EVERY - time.monotonic()
        if late <= 0:
            self._keep()
        elif self._later is None:
            self._later = threading.Timer(late, lambda: self._studio.worker.do(self._keep))
            self._later.daemon = True
            self._later.start()

    def close(self) -> None:
        """Keep at once what waits for that, and end a film."""
        self.stop()
        if self._later is not None:
            self._later.cancel()
            self._keep()

    def _keep(self) -> None:
        self._later = None
        if self.saved:
            return
        self._written = time.monotonic()
        try:
            self._spare()
            self._meshes.mend(self._studio.editor.session.stack)
            self._studio.outputs.keep(self._studio.editor.session, frames_of(self.cameras))
        except (OSError, EditError) as error:
            self._studio.say(f"⚠ Autosave is not possible: {plain(str(error))}")

    def _spare(self) -> None:
        """Before an autosave goes: move one of an earlier page, that nobody restored, aside."""
        spared = None if self._kept else self._studio.outputs.spare()
        self._kept = True
        if spared is not None:
            self._studio.say(f"What was not saved before is kept; *Open* takes {spared.name}.")

    def save(self, name: str) -> None:
        """Write the edit file, by the name that the page gives; from now on it is the one saved.

        Raises:
            InputError: a name that is none, or of a file that is there and holds no edits.
            EditError: the file cannot be written.
        """
        outputs, editor = self._studio.outputs, self._studio.editor
        path = outputs.named(name, ".json")
        if path not in (outputs.edit, self.edit) and path.exists():
            _refuse_others(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._spare()  # The edit file is older than it only now.
        gone = self._meshes.mend(editor.session.stack)
        editor.session.save(path)
        write_keys(path, self.cameras)
        outputs.forget()
        self.saved, self.edit = True, path
        lacking = f" ⚠ It names files that are gone: {', '.join(gone)}." if gone else ""
        self._studio.say(f"Saved as {path.name}.{lacking}")

    def open(self, name: str) -> None:
        """Take the edits of a file beside the edit file; undo brings the present ones back.

        Those are kept first where they are not saved; what was opened is.

        Raises:
            InputError: a name that is none, or no such file.
            EditError: the file is not valid or does not fit the points.
        """
        if self._studio.outputs.is_spared(name):
            self._resume(self._studio.outputs.folder / name)
            self.autosave()
            return
        path = self._studio.outputs.named(name, ".json")
        if not path.is_file():
            raise InputError(f"open: expected an edit file in {path.parent.name}, got no {name}")
        cameras = read_keys(path)
        self._keep()
        self._studio.editor.session.load(path)
        self.cameras, self._seen, self.saved = cameras, self._number, True
        self._studio.editor.select(None)
        self.edit = path
        self._studio.say(f"Opened {name}.")

    def camera_key(self, viewport: Viewport, what: str) -> None:
        """Key a tab's camera at the present time, or forget all camera keys."""
        camera, time = viewport.camera(), self._studio.editor.session.time
        if what == "Clear":
            self.cameras = []
        elif camera is not None:
            others = [(at, one) for at, one in self.cameras if at != time]
            self.cameras = sorted([*others, (time, camera)], key=lambda key: key[0])
        self.autosave()

    def screenshot(self, viewport: Viewport, width: int) -> None:
        """Write an exact picture of what a tab sees, and say which command makes it again."""
        studio, camera = self._studio, self._sized(viewport, width)
        editor = studio.editor
        editor.refine()
        posed = studio.drawer.posed(editor.state, still=editor.shown.still)
        path, cameras = write_picture(studio.outputs, editor.asset, posed, camera)
        light = None if editor.shown.still or editor.asset.light is None else "baked"
        edit = self.edit if editor.session.stack.edits else None
        line = studio.outputs.line("OUT", cameras, edit=edit, time=editor.session.time, light=light)
        self.line = self._told("picture", line, reads=edit is not None)
        studio.say(f"Wrote {path.name}.")

    def film(self, viewport: Viewport, count: int, width: int) -> None:
        """Begin a film of all keyframes, along the camera keys where there are two or more.

        It is written step by step; what is done meanwhile does not change it.

        Raises:
            InputError: a number of frames or a size that is none, or another film is not ready.
        """
        studio = self._studio
        if not 2 <= count <= _MOST_FRAMES:
            raise InputError(f"film: expected 2 to {_MOST_FRAMES} frames, got {count}")
        if self._filming:
            raise InputError("film: another one is being written; wait, or press Stop")
        asset, first = studio.editor.asset, self._sized(viewport, width)
        keys = [(time, one.resized(first.width, first.height)) for time, one in self.cameras]
        light = None if studio.editor.shown.still or asset.light is None else "baked"
        stack = studio.editor.session.stack
        film = Film.of(asset, stack, keys or [(0.0, first)], count, light=light)
        path = studio.outputs.next("film", ".mp4")
        write_cameras(path.with_suffix(".json"), film.cameras)
        line = film.line(studio.outputs.run, edit=self.edit, cameras=path.with_suffix(".json"))
        studio.actions.playing = False
        self._stopped.clear()
        self._filming = True
        studio.worker.go_on(self._write_film(film, path, self._told("film", line, reads=True)))

    def _write_film(self, film: Film, path: Path, line: str) -> Iterator[None]:
        """Write a film, and say at its end what became of it."""
        studio, said = self._studio, "The film was stopped."
        try:
            for share in film.write(path, self._stopped.is_set):
                studio.panels.progress(share)
                yield
            self.line, said = line, f"Wrote {path.name}."
        except RenderCancelledError:
            path.with_suffix(".json").unlink(missing_ok=True)
        except PcoreError as error:
            said = f"⚠ {plain(str(error))}"
        except OSError as error:
            said = f"⚠ {path.name}: {error.strerror or error}"
        finally:
            self._filming = False
            studio.panels.progress(None)
        studio.perform(lambda: studio.say(said))

    def _told(self, what: str, line: str, *, reads: bool) -> str:
        """What is said of a command; whether it reads the edit file, which may not be written."""
        ready = not reads or (self.saved and self.edit.is_file())
        unsaved = "" if ready else "\n\nSave first: the command reads the saved edits."
        return f"The same {what} on the command line:\n\n```\n{line}\n```{unsaved}"

    def stop(self) -> None:
        """End the film that is being written."""
        self._stopped.set()

    def restore(self) -> None:
        """Go on with the autosave; its camera keys that are damaged are left out.

        Raises:
            EditError: it is damaged, or of another object.
        """
        self._resume(self._studio.outputs.autosave)
        self._kept = True

    def _resume(self, path: Path) -> None:
        studio = self._studio
        asset = studio.editor.asset
        found = read_session(path, asset.points, rig=asset.rig)
        studio.editor.resume(found.session)
        self.cameras = keys_of(found.view.get("cameras") if isinstance(found.view, dict) else None)
        studio.say("Restored what was not saved.")

    def _sized(self, viewport: Viewport, width: int) -> Camera:
        camera = viewport.camera()
        if camera is None:
            raise EditError("picture: the window has no size yet")
        if not 16 <= width <= _LARGEST:
            raise InputError(f"picture: expected a width of 16 to {_LARGEST}, got {width}")
        height = max(16, round(width * camera.height / camera.width / 2) * 2)
        return camera.resized(round(width / 2) * 2, height)


def _refuse_others(path: Path) -> None:
    """Nothing is written over a file that is no edit file."""
    try:
        load_animation(path)
    except EditError as error:
        raise InputError(
            f"save: {path.name} is there and is no edit file; take another name"
        ) from error

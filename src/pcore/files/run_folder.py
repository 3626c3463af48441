"""The folder of a run: made before training, locked during it, never overwritten silently."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pcore.contrib.learned_skinning import Skinning
from pcore.errors import CheckpointError, TrainingError
from pcore.files.atomic import remove_partials, write_atomically
from pcore.files.closing import Closing
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.files.lock import FolderLock
from pcore.files.manifest import MANIFEST_FILE, new_manifest, read_manifest, same_run
from pcore.files.model_file import MODEL_FILE, save_model
from pcore.files.provenance import Provenance, Stage
from pcore.files.run_place import (
    RUNNING,
    check_place,
    check_space,
    probe,
    saved_nothing,
    unwritable,
)
from pcore.files.skinning_file import SKINNING_FILE, save_skinning
from pcore.files.training_state import STATE_FILE, TrainingState, load_state, save_state
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr_config import PaprConfig

LOG_FILE = "log.jsonl"
_TENSORBOARD = "tensorboard"


class RunFolder(Closing):
    """A folder that holds one run: `run.json`, weights, state, logs, pictures.

    Make one with `create` (to train, in a `with` statement: it holds a lock) or `open` (to read).
    """

    def __init__(self, path: Path, manifest: dict[str, Any], lock: FolderLock | None) -> None:
        self.path = path
        self._manifest = manifest
        self._lock = lock

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        stage: Stage,
        scene: str,
        config: Mapping[str, Any],
        resume: bool = False,
        needed: int = 0,
    ) -> RunFolder:
        """Make or continue a run folder, after all that can be known beforehand is checked.

        Args:
            path: the folder; made with its parents.
            stage: what will run in it.
            scene: path or name of the scene, for people.
            config: all that decides the result, as JSON values.
            resume: continue the run that is there.
            needed: bytes that will be written, see `bytes_needed`.

        Raises:
            InputError: the folder holds another run or foreign files, or nothing to resume, or a
                run of another configuration (names the keys), or another process trains in it.
            TrainingError: the folder cannot be written or its disk is too full.
            CheckpointError: its `run.json` is damaged or not ours.
        """
        check_place(path, resume=resume)
        check_space(path, needed)
        with unwritable(path):
            path.mkdir(parents=True, exist_ok=True)
            lock = FolderLock.acquire(path)
            try:
                check_place(path, resume=resume)  # Somebody may have been faster.
                remove_partials(path)
                probe(path)
                manifest = new_manifest(stage, scene, config)
                if saved_nothing(path):
                    (path / LOG_FILE).unlink(missing_ok=True)
                    shutil.rmtree(path / _TENSORBOARD, ignore_errors=True)
                elif (path / MANIFEST_FILE).exists():
                    manifest = same_run(path, manifest)
                run = cls(path, manifest, lock)
                run.update(status=RUNNING)
            except BaseException:
                lock.release()
                raise
        return run

    @classmethod
    def open(cls, path: Path | str) -> RunFolder:
        """Return the run in `path` for reading; raises CheckpointError when there is none."""
        return cls(Path(path), read_manifest(Path(path)), None)

    @property
    def model(self) -> Path:
        """The weights for users, `model.safetensors`."""
        return self.path / MODEL_FILE

    @property
    def gaussians(self) -> Path:
        """The Gaussians for users, `gaussians.safetensors`; of an object made of them."""
        return self.path / GAUSSIANS_FILE

    @property
    def skinning(self) -> Path:
        """The skinning for users, `skinning.safetensors`; only where one was trained."""
        return self.path / SKINNING_FILE

    @property
    def state(self) -> Path:
        """The state for resuming, `state.pt`."""
        return self.path / STATE_FILE

    @property
    def log(self) -> Path:
        """The events, one JSON object per line."""
        return self.path / LOG_FILE

    @property
    def tensorboard(self) -> Path:
        """The folder of TensorBoard's event files."""
        return self.path / _TENSORBOARD

    @property
    def renders(self) -> Path:
        """The folder of pictures."""
        return self.path / "renders"

    @property
    def stage(self) -> Stage:
        """What ran or runs here."""
        return self._manifest["stage"]

    @property
    def scene(self) -> str:
        """The scene it was started with."""
        return self._manifest["scene"]

    @property
    def config(self) -> dict[str, Any]:
        """The configuration it was started with, as JSON values."""
        return self._manifest["config"]

    @property
    def notes(self) -> dict[str, Any]:
        """What `update` wrote down: status, steps, scores."""
        return self._manifest["notes"]

    def update(self, **notes: Any) -> None:
        """Write facts (JSON values) into `run.json`, keeping the others."""
        self._manifest["notes"] = {**self.notes, **notes}
        text = json.dumps(self._manifest, indent=2) + "\n"
        with write_guard(self.path / MANIFEST_FILE):
            write_atomically(self.path / MANIFEST_FILE, text.encode())

    def save_state(self, state: TrainingState) -> None:
        """Write `state.pt`; raises TrainingError (disk full, ...) that says what is still good."""
        with write_guard(self.state):
            save_state(self.state, state)

    def load_state(self) -> TrainingState | None:
        """Return the state to go on from; None when the run was killed before its first save."""
        return load_state(self.state) if self.state.exists() else None

    def saved_step(self) -> int | None:
        """Step of the saved state; None before the first save."""
        state = self.load_state()
        return None if state is None else state.step

    def save_model(
        self,
        papr_state: Mapping[str, Any],
        cloud: PointCloud,
        config: PaprConfig,
        provenance: Provenance,
        surfels: Surfels | None = None,
    ) -> None:
        """Write `model.safetensors`; raises TrainingError as `save_state`."""
        with write_guard(self.model):
            save_model(self.model, papr_state, cloud, config, provenance, surfels)

    def save_skinning(self, skinning: Skinning) -> None:
        """Write `skinning.safetensors`; raises TrainingError as `save_state`."""
        with write_guard(self.skinning):
            save_skinning(self.skinning, skinning)

    def close(self) -> None:
        """Let other processes use the folder."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None


@contextmanager
def write_guard(path: Path) -> Generator[None]:
    """Turn a failure to write `path`, a file of a run folder, into a TrainingError.

    The message says what the run folder still holds; files are replaced atomically, so what is
    there is whole.
    """
    try:
        yield
    except OSError as error:
        raise TrainingError(
            f"cannot write {path}: {error.strerror or error}; {_what_is_saved(path.parent)}. Free "
            "space on that disk or make it writable, then give the same command again "
            "(`pcore train` and `pcore finetune` with --resume)"
        ) from error


def _what_is_saved(folder: Path) -> str:
    """Say which files a run folder holds and at which step its state stands."""
    parts: list[str] = []
    try:
        parts.append(f"{STATE_FILE} of step {load_state(folder / STATE_FILE).step}")
    except (CheckpointError, OSError):
        parts += []  # Before the first checkpoint, or the disk is gone altogether.
    names = (MODEL_FILE, GAUSSIANS_FILE, SKINNING_FILE, LOG_FILE, MANIFEST_FILE)
    parts += [name for name in names if (folder / name).is_file()]
    if not parts:
        return f"nothing was saved in {folder} before"
    return f"already saved and undamaged in {folder}: {', '.join(parts)}"

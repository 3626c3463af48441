"""What `run.json` says about how an object came to be, as a value."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import torch

from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.files.manifest import MANIFEST_FILE, read_manifest
from pcore.files.model_file import MODEL_FILE
from pcore.files.provenance import Stage
from pcore.geometry.object_region import Region

SPENT = "processor_seconds"
"""The note of what a training took, without the light."""


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """How an object came to be.

    Attributes:
        path: folder of the run; None where there is none, as of a bare model file.
        stage: what made it.
        scene: folder of the scene, as seen from the run; a name after an import without photos; may
            be empty.
        config: what the result depends on, as JSON values.
        notes: what was written down meanwhile: status, steps, scores.
    """

    path: Path | None = None
    stage: Stage
    scene: str = ""
    config: Mapping[str, Any] = field(default_factory=dict[str, Any])
    notes: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @classmethod
    def read(cls, path: Path) -> RunRecord:
        """Read that of a run folder; raises CheckpointError when there is none."""
        manifest = read_manifest(path)
        return cls(
            path=path, **{key: manifest[key] for key in ("stage", "scene", "config", "notes")}
        )

    def without_folder(self) -> RunRecord:
        """Return the same of an object in memory: no place counts from its run's folder."""
        places = {"base": self.base, "masks": self.masks}
        known = {name: str(place.resolve()) for name, place in places.items() if place is not None}
        folder = self.scene_folder
        scene = self.scene if folder is None else str(folder.resolve())
        return replace(self, path=None, scene=scene, config={**self.config, **known})

    @property
    def factor(self) -> int:
        """Down-scaling factor that the training images had; 1 when none is on record."""
        found = self.config.get("factor")
        return found if isinstance(found, int) and found > 0 else 1

    @property
    def masks(self) -> Path | None:
        """Folder of masks that the training took besides the photos; None: it took none."""
        found = self.config.get("masks")
        return None if found is None else (self.path or Path()) / str(found)

    @property
    def region(self) -> Region | None:
        """Where the object was found; None where the viewing axes told it, or nobody looked."""
        found = self.config.get("region")
        if not isinstance(found, dict):
            return None
        kept = cast("dict[str, Any]", found)
        box = kept.get("box")
        return Region(
            center=torch.tensor(kept["center"]),
            radius=float(kept["radius"]),
            box=None if box is None else torch.tensor(box),
        )

    @property
    def base(self) -> Path | None:
        """Folder of the run that this one was fine-tuned from; None for other runs."""
        found = self.config.get("base")
        return None if found is None else (self.path or Path()) / str(found)

    @property
    def seconds(self) -> float | None:
        """Of the processor, for the training and the one that it began with; None: not known."""
        found = self.notes.get(SPENT)
        if not isinstance(found, int | float):
            return None
        if self.base is None:
            return float(found)
        before = RunRecord.read(self.base).seconds if begun(self.base) else None
        return None if before is None else before + found

    @property
    def scene_folder(self) -> Path | None:
        """Folder (or file) of the scene that it was trained on; None when it is not here."""
        if not self.scene or (self.stage == "import" and "factor" not in self.config):
            # An import that was shown no photos records a name (one that was, their factor, too),
            # and a folder of that name may be anything.
            return None
        # Our own runs record it as seen from the run, so that both can move together.
        beside = () if self.path is None else (self.path / self.scene,)
        candidates = (*beside, Path(self.scene))
        # Names that are too long are an error to pathlib, and here a folder that is not there.
        return next((one for one in candidates if os.path.exists(one)), None)  # noqa: PTH110

    def scene_or(self, given: Path | None) -> Path:
        """Folder of the scene to work on: the one given, else the one it was trained on.

        Raises:
            InputError: none is given and that of the run is not there (any more).
        """
        folder = given or self.scene_folder
        if folder is None:
            raise InputError(
                f"{self.path or 'this model'}: the scene it was trained on "
                f"({self.scene or 'not recorded'}) is not a folder here; give the scene's folder "
                "with --scene"
            )
        return folder


def of_scene(scene: Scene, run: Path | None) -> dict[str, Any]:
    """What a record says of a scene beside its folder: factor, masks from elsewhere, region."""
    known: dict[str, Any] = {"factor": scene.factor}
    if scene.masks is not None:
        known["masks"] = str(scene.masks) if run is None else relative(scene.masks, run)
    if scene.region is not None:
        region = scene.region
        known["region"] = {
            "center": region.center.tolist(),
            "radius": region.radius,
            "box": None if region.box is None else region.box.tolist(),
        }
    return known


def begun(path: Path) -> bool:
    """Whether a folder holds a run, finished or not."""
    return (path / MANIFEST_FILE).is_file()


def finished(path: Path) -> bool:
    """Whether a folder holds a training that came to its end."""
    if not begun(path):
        return False
    drawn = any((path / name).is_file() for name in (MODEL_FILE, GAUSSIANS_FILE))
    return drawn and RunRecord.read(path).notes.get("status") == "finished"


def relative(target: Path, start: Path) -> str:
    """Path of `target` as seen from the folder `start`, with forward slashes."""
    try:
        return Path(os.path.relpath(target.resolve(), start.resolve())).as_posix()
    except ValueError:  # Another drive of Windows.
        return str(target.resolve())

"""A training of either kind of object, in a run folder or in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.lighting import lit
from pcore.asset.saving import asset_of, load
from pcore.data.scene import Scene
from pcore.files.run_folder import RunFolder
from pcore.files.run_place import bytes_needed
from pcore.files.run_record import RunRecord
from pcore.training.events import Listener
from pcore.training.in_folder import RunOptions, train_in_folder
from pcore.training.trainable_gaussians import TrainedGaussians, provenance_of_gaussians
from pcore.training.trained import Trained

_NUMBERS = 11
"""Of a Gaussian besides its harmonics."""

Result = TypeVar("Result", Trained, TrainedGaussians)


@dataclass(frozen=True, kw_only=True, eq=False)
class Job(Generic[Result]):
    """A training.

    Attributes:
        record: what is written down of it; its folder is that of the run, None keeps everything in
            memory.
        learn: trains in the folder, or in memory, and tells the listener.
        needed: bytes that it will write.
    """

    record: RunRecord
    learn: Callable[[RunFolder | None, Listener], Result]
    needed: int

    def made(self, scene: Scene, listener: Listener, device: str, options: RunOptions) -> Asset:
        """Train, and estimate the light; a finished run is left as it is.

        Args:
            scene: the one that it learns from.
            listener: told of all events.
            device: where the object draws.
            options: light, resuming, logs.
        """
        place = scene.name if scene.folder is None else scene.folder.resolve()
        if self.record.path is None:
            learned = self.learn(None, listener)
            asset = _in_memory(learned, scene, self.record, device)
            asset = replace(asset, record=replace(self.record, scene=str(place)))
        else:
            learned = train_in_folder(
                self.record,
                self.learn,
                listener,
                options,
                scene=place,
                device=device,
                needed=self.needed,
            )
            asset = load(self.record.path, device=device)
        if learned is None and asset.light is not None:
            return asset
        # Whoever was killed after the last save and before the light was has none yet.
        observed = learned.observed if isinstance(learned, Trained) else None
        return lit(asset, scene, options, observed)


def gaussian_space(count: int, degree: int) -> int:
    """Bytes that a run of so many Gaussians will need."""
    return bytes_needed((_NUMBERS + 3 * (degree + 1) ** 2) * count)


def _in_memory(
    found: Trained | TrainedGaussians, scene: Scene, record: RunRecord, device: str
) -> Asset:
    """The same asset as one that is read from a folder."""
    if isinstance(found, Trained):
        return asset_of(
            found.papr,
            found.cloud,
            scene=scene.name,
            stage=record.stage,
            step=found.step,
            surfels=found.surfels,
            skinning=found.skinning,
        )
    content = GaussianContent(
        gaussians=found.gaussians.to(device),
        footprint=found.footprint,
        background=found.background,
    )
    provenance = provenance_of_gaussians(found, scene.name)
    return Asset(content=content, provenance=provenance, record=record)

"""`pcore import papr`: bring a checkpoint of the original PAPR in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.options import optional
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.model.papr_config import ReferenceOrigin


@dataclass(frozen=True, kw_only=True)
class ImportPaprCommand:
    """Make a run of an official PAPR checkpoint; it is then used like one of our own.

    The file is untrusted: only tensors are read, nothing in it is executed.
    """

    model: Annotated[Positional[Path], arg(metavar="MODEL.PTH")]
    """The original's model.pth."""

    config: Annotated[tuple[Path, ...], arg(metavar="FILE [FILE ...]")]
    """Its YAML configuration; of several files (default.yml lego.yml) the later ones win."""

    reference_distance: Annotated[float | None, optional("R")] = None
    """Let all rays begin at this distance before the reference center instead of at the camera, so
    that edits and cameras at other distances look right: the mean distance of the training cameras
    (4.031 for NeRF-Synthetic). Default: the original's rays, from the camera."""

    reference_center: Annotated[tuple[float, float, float] | None, optional("X Y Z")] = None
    """Middle of the scene for --reference-distance, world units; default: the origin."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder to make; it must be new or empty."""

    def run(self) -> None:
        """Import; raises CheckpointError, InputError or TrainingError and then leaves no run."""
        from pcore.asset.importing import import_papr

        asset = import_papr(self.model, self.config, self.output, reference=self._reference())
        came = asset.provenance
        text = f"{self.output}: {came.scene}, {len(asset):,} points, {came.step:,} steps"
        say(Console(), text)

    def _reference(self) -> ReferenceOrigin | None:
        from pcore.model.papr_config import ReferenceOrigin

        if self.reference_distance is None:
            if self.reference_center is not None:
                raise InputError("--reference-center is for --reference-distance: give both")
            return None
        center = self.reference_center or (0.0, 0.0, 0.0)
        return ReferenceOrigin(center=center, distance=self.reference_distance)

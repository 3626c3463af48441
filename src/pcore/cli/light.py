"""`pcore light RUN`: estimate the light of the photos, so that it stays put while points move."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note
from pcore.cli.options import Count, Folder, optional
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.data.scene import Scene

LightName = Literal["still", "baked"]
LightChoice = Annotated[LightName | None, optional("{still,baked}")]
"""What the light does while an object moves; may be left out."""


@dataclass(frozen=True, kw_only=True)
class LightCommand:
    """Estimate the light of a run's training photos and write it beside the model.

    From then on `pcore render`, `pcore animate` and `pcore eval` light deformed points anew (not
    with `--light baked`). Where the model does not know the surface over its points, as after
    `pcore import papr`, that is estimated as well and kept in the model file; Gaussians get the
    normals of the surface that they are pieces of. `pcore train` and `pcore finetune` do all this
    at their end.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of the run, our own or imported."""

    scene: Folder = None
    """Folder of the scene; default: the one the run was trained on."""

    factor: Count = None
    """Down-scaling of the images; default: that of the training."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Estimate; raises PcoreError subclasses for what the user can mend."""
        from pcore.asset.saving import load

        prepare_torch(self.threads)
        asset = load(self.run_folder, device=pick_device(self.device))
        scene, console = asset.scene(self.scene, factor=self.factor), Console()
        note(console, scene.notes)
        estimate(asset, scene, console)


def estimate(asset: Asset, scene: Scene, console: Console) -> None:
    """Estimate the light of a run, write it into its folder and say what it is."""
    from pcore.asset.lighting import estimate_light
    from pcore.files.model_file import MODEL_FILE, describe_model

    known = not (asset.path / MODEL_FILE).is_file() or describe_model(asset.path).surfels
    try:
        with counting(console, "light: views") as tell:
            made = estimate_light(asset, scene, progress=tell)
    finally:
        if not known and describe_model(asset.path).surfels:
            where = asset.path / MODEL_FILE
            text = f"{where}: the surface over the points was not known; estimated now and kept"
            say(console, text)
    show_light(made, console)


def show_light(asset: Asset, console: Console) -> None:
    """Say what the light of a run is, where one was estimated."""
    from pcore.relight.description import describe_light
    from pcore.relight.light_file import LIGHT_FILE

    light, surfels = asset.light, asset.content.surfels
    if light is not None and surfels is not None:
        text = f"{asset.path / LIGHT_FILE}: {describe_light(light, surfels)}"
        say(console, text)

"""`pcore light RUN`: estimate the light of the photos, so that it stays put while points move."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.options import Count, Folder, optional
from pcore.cli.runtime import DeviceName
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.asset.asset import Asset
    from pcore.data.scene import Scene

LightName = Literal["still", "baked"]
LightChoice = Annotated[LightName | None, optional("{still,baked}")]
"""What the light does while an object moves; may be left out."""


@dataclass(frozen=True, kw_only=True)
class LightCommand:
    """Estimate the light of a run's training photos and write it beside the model.

    From then on `pcore render`, `pcore animate` and `pcore eval` light deformed points anew, and
    pictures of `render` are as deep as the surface, not as the points (`--light baked`: neither).
    `pcore train` and `pcore finetune` do this at their end.
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
        from pcore.cli.diagnosing import note
        from pcore.cli.runtime import pick_device, prepare_torch

        prepare_torch(self.threads)
        asset = load(self.run_folder, device=pick_device(self.device))
        scene, console = asset.scene(self.scene, factor=self.factor), Console()
        note(console, scene.notes)
        show_light(asset, scene, console)


def show_light(asset: Asset, scene: Scene, console: Console) -> None:
    """Estimate the light of a run, write it into its folder and say what it is.

    Raises:
        InputError: too few points have a normal that the views agree on, or there is no folder.
        OSError: the file cannot be written.
    """
    from pcore.asset.training import estimate_light
    from pcore.cli.results import counting
    from pcore.relight.description import describe_light
    from pcore.relight.light_file import LIGHT_FILE

    file = asset.path / LIGHT_FILE
    with counting(console, "light: views") as tell:
        light = estimate_light(asset, scene, progress=tell).light
    if light is not None:
        console.print(Text(f"{file}: {describe_light(light)}"), soft_wrap=True)


def try_light(asset: Asset, scene: Scene, console: Console) -> None:
    """Estimate the light at the end of a training; say so where that is not possible."""
    try:
        show_light(asset, scene, console)
    except (InputError, OSError) as error:
        console.print(Text(f"note: {error}"), soft_wrap=True)

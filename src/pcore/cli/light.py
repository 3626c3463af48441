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
    from pcore.data.scene import Scene
    from pcore.geometry.point_cloud import PointCloud
    from pcore.relight.shading import Shading

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
        from pcore.cli.runtime import pick_device, prepare_torch, recorded_factor, scene_of
        from pcore.data.load import load_scene
        from pcore.files.run_folder import RunFolder

        prepare_torch(self.threads)
        device = pick_device(self.device)
        run = RunFolder.open(self.run_folder)
        factor = recorded_factor(run) if self.factor is None else self.factor
        scene = load_scene(scene_of(run, self.scene), factor=factor)
        estimate_light(self.run_folder, scene, device, Console())


def estimate_light(path: Path, scene: Scene, device: str, console: Console) -> None:
    """Estimate the light of a run, write it into its folder and say what it is.

    Raises:
        CheckpointError: the run's model is missing or damaged.
        InputError: too few points have a normal that the views agree on.
        OSError: the file cannot be written.
    """
    from pcore.cli.results import counting
    from pcore.data.scene import check_images
    from pcore.files.model_file import load_model
    from pcore.relight.estimate import fit_shading
    from pcore.relight.light_file import LIGHT_FILE, save_shading

    saved, views = load_model(path), scene.split("train")
    check_images(views)
    with counting(console, "light: views") as tell:
        shading = fit_shading(saved.papr().to(device), saved.cloud, views, progress=tell)
    save_shading(path / LIGHT_FILE, shading)
    console.print(Text(f"{path / LIGHT_FILE}: {description(shading)}"), soft_wrap=True)


def try_light(path: Path, scene: Scene, device: str, console: Console) -> None:
    """Estimate the light at the end of a training; say so where that is not possible.

    Raises:
        CheckpointError: the run's model is missing or damaged.
    """
    try:
        estimate_light(path, scene, device, console)
    except (InputError, OSError) as error:
        console.print(Text(f"note: {error}"), soft_wrap=True)


def description(shading: Shading) -> str:
    """Say where the most light comes from and how far, how uneven it is, and who has a normal."""
    import torch

    light = shading.light
    # Of all ways a surface can face: the best and the worst lit.
    falling = light.irradiance(light.directions)
    x, y, z = (float(one) for one in light.directions[int(falling.argmax())])
    ratio = float(falling.max() / falling.min().clamp_min(1e-3 * falling.max()))
    known = float(shading.known.to(torch.float32).mean())
    shown = shading.positions[shading.known]
    size = float((shown.amax(dim=0) - shown.amin(dim=0)).norm()) if len(shown) else 0.0
    nearness = size * light.mean_nearness
    # Beyond that the light on an object varies by a few percent.
    distance = f"{1 / nearness:.1f} times the object's size" if nearness > 0.02 else "far"
    return (
        f"brightest on surfaces that face ({x:.2f}, {y:.2f}, {z:.2f}), {ratio:.1f} times the light "
        f"of the darkest; lamps are {distance} away; "
        f"{100 * known:.0f} % of the points have a normal, the surface lies {shading.lift:.2g} "
        "above them"
    )


def shading_of(
    path: Path, cloud: PointCloud, choice: LightName | None, *, aware: bool
) -> Shading | None:
    """Read the light that pictures of a run's deformed points should have; None: as photographed.

    Args:
        path: folder of the run, or a model file, which has no light beside it.
        cloud: its canonical points.
        choice: what was asked for; None takes a light that stands still where the run has one and
            rays are aware of the deformation.
        aware: whether they are.

    Raises:
        CheckpointError: the file is damaged or belongs to other points.
        InputError: a light is asked for and there is none.
    """
    from pcore.relight.light_file import LIGHT_FILE, load_shading

    if choice == "baked" or (choice is None and not aware):
        return None
    if not (path / LIGHT_FILE).is_file():
        if choice is None:
            return None
        raise InputError(
            f"--light still: expected a {LIGHT_FILE} in the folder of the run, found none in "
            f"{path}; estimate it with `pcore light RUN`"
        )
    return load_shading(path, cloud.positions)

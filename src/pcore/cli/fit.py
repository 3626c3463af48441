"""`pcore fit RUN --photos SCENE`: the pose of an object from photos of its deformed state."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.options import Count, optional
from pcore.cli.output import check_place
from pcore.cli.runtime import DeviceName, pick_device, prepare_torch
from pcore.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pcore.asset.asset import Asset
    from pcore.data.scene import View
    from pcore.editing.animation import Animation
    from pcore.editing.script import EditScript
    from pcore.fitting.pose_fit import PoseFit
    from pcore.fitting.shown_object import Shown


@dataclass(frozen=True, kw_only=True)
class FitCommand:
    """Find the pose of a trained object in photos of its deformed state.

    The result is an edit file, whose handles are all anchors of the object: `pcore render RUN
    --edit edit.json` draws it. Photos need masks, and cameras in the world of the run.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of the run."""

    photos: Annotated[tuple[Path, ...], arg(metavar="SCENE")]
    """Scene with the photos, or SCENE/STATE of a scene with deformed states. Several are states of
    a motion in the order of time, which become keyframes."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """Edit file (.json) to write; replaced if it exists."""

    start: Annotated[Path | None, optional("FILE")] = None
    """Edit file of a pose to start from; default: as the object was photographed."""

    free: Annotated[tuple[str, ...], arg(metavar="NAME")] = ()
    """Change only these numbers of the edit file --start, such as edits.0.angle_deg with edits from
    0; the result is that edit. Default: all anchors are free."""

    appearance: Annotated[Path | None, optional("FOLDER")] = None
    """Let the colours follow the photos as well, and write the object with them as a new run."""

    times: Annotated[tuple[float, ...], arg(metavar="T")] = ()
    """Times of the keyframes, one for each --photos; default: evenly from 0 to 1."""

    every: Annotated[int, arg(metavar="N")] = 1
    """Use every Nth photo, from the first."""

    factor: Count = None
    """Down-scaling of the photos; default: that of the training."""

    anchors: Annotated[int, arg(metavar="N")] = 512
    """Anchors that carry the object at last; at most one for every point."""

    seed: Annotated[int, arg(metavar="N")] = 0
    """Of the choice of anchors and the order of photos."""

    silhouettes: bool = False
    """Compare outlines only, not colours: for masks, or photos in another light."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Fit; raises PcoreError subclasses for what the user can mend."""
        from pcore.asset.saving import load
        from pcore.fitting.fit_sequence import check_times
        from pcore.fitting.shown_object import Shown

        self._check()
        if self.times:
            check_times(self.times, len(self.photos))
        prepare_torch(self.threads)
        asset = load(self.run_folder, device=pick_device(self.device))
        factor = asset.record.factor if self.factor is None else self.factor
        states = [photos_in(path, factor)[:: self.every] for path in self.photos]
        console = Console()
        with counting(console, "Gaussians in its place: pictures and steps") as tell:
            shown = Shown.of(asset, tell)
        with counting(console, "steps") as tell:
            result, fits = self._fitted(shown, states, tell)
        result.save(self.output)
        self._show(console, states, fits)
        if self.appearance is not None:
            self._paint(asset, fits[0].edit, states[0], self.appearance, console)

    def _fitted(
        self, shown: Shown, states: list[tuple[View, ...]], tell: Callable[[int, int], None]
    ) -> tuple[EditScript | Animation, list[PoseFit]]:
        """The edit that was found, and how well it fits each state."""
        from pcore.fitting.fit_config import FitConfig
        from pcore.fitting.fit_sequence import fit_sequence
        from pcore.fitting.numbers_fit import fit_numbers
        from pcore.fitting.pose_fit import fit_pose

        asset = shown.asset
        config = FitConfig(anchors=self.anchors, seed=self.seed, silhouettes=self.silhouettes)
        if len(states) > 1:
            times = self.times or None
            found = fit_sequence(
                asset,
                states,
                config,
                times=times,
                start=self.start,
                shown=shown,
                progress=tell,
                keep=lambda so_far: so_far.save(self.output),
            )
            return found.animation, list(found.fits)
        if self.free and self.start is not None:
            fit = fit_numbers(
                asset,
                self.start,
                self.free,
                states[0],
                silhouettes=self.silhouettes,
                shown=shown,
                progress=tell,
            )
        else:
            fit = fit_pose(asset, states[0], config, start=self.start, shown=shown, progress=tell)
        return fit.edit, [fit]

    def _check(self) -> None:
        from pcore.validation import check_count

        if not self.photos:
            raise InputError("fit: expected at least one scene with --photos, got none")
        if self.output.suffix != ".json":
            raise InputError(f"-o {self.output}: expected a name that ends in .json")
        check_place(self.output.parent)
        check_count("--every", self.every)
        if self.times and len(self.photos) == 1:
            raise InputError("--times: expected several --photos, whose times they are, got one")
        if self.free and (self.start is None or len(self.photos) > 1):
            raise InputError("--free: expected --start, whose numbers they are, and one --photos")
        folder = self.appearance
        if folder is not None and len(self.photos) > 1:
            raise InputError("--appearance: expected one --photos, whose colours are meant")
        if folder is not None and folder.exists() and (folder.is_file() or any(folder.iterdir())):
            raise InputError(
                f"--appearance {folder}: expected a new or empty folder, got one with files"
            )
        if folder is not None:
            check_place(folder)

    def _paint(
        self, asset: Asset, edit: EditScript, views: Sequence[View], folder: Path, console: Console
    ) -> None:
        from pcore.fitting.appearance_fit import fit_appearance

        with counting(console, "appearance: steps") as tell:
            painted = fit_appearance(asset, edit, views, progress=tell)
        painted.save(folder)
        text = f"{folder}: the object in the colours of the photos\nnext: pcore render {folder}"
        say(console, f"{text} --edit {self.output}")

    def _show(
        self, console: Console, states: Sequence[Sequence[View]], fits: Sequence[PoseFit]
    ) -> None:
        for path, views, fit in zip(self.photos, states, fits, strict=True):
            before, after = fit.before, fit.after
            line = (
                f"{path}: {len(views)} photos, foreground PSNR {before.psnr:.2f} -> "
                f"{after.psnr:.2f} dB, outlines overlap {before.overlap:.1%} -> {after.overlap:.1%}"
            )
            say(console, line)
        follow = "animate" if len(fits) > 1 else "render"
        text = f"{self.output}\nnext: pcore {follow} {self.run_folder} --edit {self.output}"
        say(console, text)


def photos_in(path: Path, factor: int) -> tuple[View, ...]:
    """Return the photos of a scene, or those of a deformed state of one by its folder."""
    from pcore.capture.load import find_states, load_scene, load_state

    parent = path.parent
    if parent.is_dir() and path.name in find_states(parent):
        scene = load_state(parent, path.name, factor=factor)
        return scene.split("train" if "train" in scene.splits else "test")
    return load_scene(path, factor=factor).split("train")

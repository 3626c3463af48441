"""`pcore check SCENE`: what a capture is worth before it is trained, and what to mend."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from rich.console import Console
from rich.text import Text
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.layout import pair_lines, room
from pcore.cli.options import Count, Folder, optional
from pcore.cli.output import check_place
from pcore.cli.runtime import prepare_torch
from pcore.data.whole_file import write_whole
from pcore.errors import InputError

if TYPE_CHECKING:
    from pcore.data.scene import Scene
    from pcore.evaluation.scene_check import SceneCheck

_LONGEST = 400
"""Photos are looked at in about this size unless --factor says otherwise."""
_AUTOMATIC: dict[str | None, Literal["cut", "trained"]] = {
    None: "cut",
    "auto": "cut",
    "trained": "trained",
}
_MARKS = {"warning": ("!!", "yellow"), "note": ("--", "cyan"), "good": ("ok", "green")}


@dataclass(frozen=True, kw_only=True)
class CheckCommand:
    """Look at a scene before training: poses, photos, coverage, masks, region, time.

    Nothing is trained but for --masks trained, and nothing is written into the scene's folder.
    """

    scene: Annotated[Positional[Path], arg(metavar="SCENE")]
    """The scene, in any layout that `pcore train` reads."""

    html: Annotated[Path | None, optional("FILE", "-o")] = None
    """Also write the report with pictures, one HTML file that needs nothing else."""

    masks: Annotated[str | None, optional("auto|trained|none|FOLDER")] = None
    """Where photos show the object: auto (cut out of them), trained (learn the whole room for one
    or two minutes and draw the object alone), a folder of masks, or none. Default: those that the
    scene brings; auto where it brings none."""

    box: Annotated[tuple[float, ...], arg(metavar="X Y Z X Y Z", help_behavior_hint="")] = ()
    """Lower and upper corner of the object in world units; default: found."""

    triangulate: bool = False
    """Match features of the photos and hold them against the poses, by COLMAP, some minutes; for
    scenes without sparse points."""

    masks_out: Folder = None
    """Write the masks there, named like the photos, to look at and correct."""

    fix: Folder = None
    """Write a corrected copy there: straight pictures with masks, cut to the object, without photos
    that are blurred or badly posed."""

    factor: Count = None
    """Down-scale photos by this whole number; default: one that makes them about 400 pixels long
    for looking, 1 for --fix and --masks-out."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Print the findings; raises PcoreError subclasses for what the user can mend."""
        check(self, Console())


def check(command: CheckCommand, console: Console) -> None:
    """Check as the command line says."""
    from pcore.capture.triangulation import triangulated
    from pcore.cli.scenes import corners_of
    from pcore.evaluation.report import require_jinja
    from pcore.evaluation.scene_check import check_scene

    if command.html is not None:
        require_jinja()
    _check_places(command)
    prepare_torch(command.threads)
    factor = command.factor or _looking_factor(command.scene, console)
    scene, bare = _opened(command, factor, console)
    agreement = None
    if command.triangulate and scene.sparse is None:
        done = triangulated(bare, partial(say, console))
        scene, agreement = replace(scene, sparse=done.scene.sparse), done.agreement
        if agreement is None:
            say(console, "no two photos show common features, so nothing checks the poses")
    with counting(console, "masks") as tell:
        found = check_scene(
            scene,
            bare,
            agreement=agreement,
            box=corners_of(command.box),
            automatic=_AUTOMATIC.get(command.masks),
            progress=lambda what, done, total: tell(done, total),
        )
    _show(found, console)
    following = commands_of(found, command, factor)
    if command.html is not None:
        _write_page(found, command, following, console)
    else:
        say(console, "with pictures: add --html report.html")
    if command.masks_out is not None:
        _write_masks(found, command, console)
    if command.fix is not None:
        _write_fixed(found, command, console)
    say(console, f"next: {following[0]}")


def _check_places(command: CheckCommand) -> None:
    """Refuse, before any work, places that cannot be written to or hold something already."""
    page = None if command.html is None else command.html.parent
    for folder in (command.masks_out, command.fix, page):
        if folder is not None:
            check_place(folder)
    masks = command.masks_out
    if masks is not None and masks.is_dir() and any(masks.iterdir()):
        raise InputError(
            f"{masks}: expected a new or empty folder for the masks; those in it may have been "
            "corrected by hand: choose another, or empty it"
        )


def _opened(command: CheckCommand, factor: int, console: Console) -> tuple[Scene, Scene]:
    """The scene with its masks and without any."""
    from pcore.capture.load import load_scene
    from pcore.data.masks import check_masks

    if command.masks in ("none", "auto", "trained"):
        bare = load_scene(command.scene, factor=factor, masks="none", tell=partial(say, console))
        return bare, bare
    folder = None if command.masks is None else Path(command.masks)
    scene = load_scene(command.scene, factor=factor, masks=folder, tell=partial(say, console))
    if all(view.image.mask is None for view in scene.split("train")):
        return scene, scene  # What alpha there is is the photos' own: they are decoded once.
    bare = load_scene(command.scene, factor=factor, masks="none")
    if scene.split("train")[0].has_alpha:
        return scene, bare
    say(console, *[f"note: {one}" for one in check_masks(scene.split("train"))])
    return bare, bare


def _looking_factor(path: Path, console: Console) -> int:
    """A factor that makes photos about as long as is looked at; it divides rendered ones."""
    from pcore.capture.layouts import RENDERED
    from pcore.capture.load import load_scene

    scene = load_scene(path, tell=partial(say, console))
    camera = scene.split("train")[0].camera
    wish = max(1, int(1.25 * max(camera.width, camera.height) / _LONGEST))
    if scene.layout != RENDERED:
        return wish
    return max(n for n in range(1, wish + 1) if camera.width % n == camera.height % n == 0)


def _show(found: SceneCheck, console: Console) -> None:
    from pcore.evaluation.check_page import facts, forecast_row, summary

    say(console, f"{found.scene.name}: {summary(found)}", style="bold")
    say(console, *pair_lines(list(facts(found)), room(console)))
    for one in found.scene.skipped:
        say(console, f"  skipped {one.name}: {one.reason}")
    for one in found.findings:
        line = Text.assemble(_MARKS[one.level], f" {one.topic}: {one.text}")
        say(console, line)
        if one.action:
            say(console, f"   {one.action}", style="dim")
    for row in map(forecast_row, found.forecasts):
        begins = row[1] != "-"
        told = f"{row[1]}, {row[2]}; quality {row[3]} ({row[4]})" if begins else row[4]
        say(console, f"{row[0]}: {told}")


def _write_masks(found: SceneCheck, command: CheckCommand, console: Console) -> None:
    from pcore.capture.corrected_copy import check_outside
    from pcore.capture.mask_folder import write_masks

    assert command.masks_out is not None, "asked for"
    if found.masks is None:
        raise InputError(f"--masks-out: there are no masks to write: {found.no_masks or 'none'}")
    check_outside(found.scene, command.masks_out)
    write_masks(found.views, found.masks.masks, command.masks_out)
    say(
        console,
        f"{len(found.views)} masks are in {command.masks_out}; white is object. Train with "
        f"--masks {command.masks_out}",
    )


def _write_fixed(found: SceneCheck, command: CheckCommand, console: Console) -> None:
    from pcore.capture.corrected_copy import write_corrected
    from pcore.capture.scene_masks import ordered_keys

    assert command.fix is not None, "asked for"
    bad = {*found.quality.blurred, *found.quality.odd_exposure}
    if found.agreement is not None:
        bad |= {*found.agreement.doubtful()}
    if found.reprojection is not None:
        bad |= {*found.reprojection.doubtful()}
    keys = ordered_keys(found.scene)
    left_out = [keys[i] for i in sorted(bad)]
    scene = _opened(command, command.factor or 1, console)[0]
    if command.box:
        scene = replace(scene, region=found.region)
    if scene.sparse is None:  # Those that were triangulated now.
        scene = replace(scene, sparse=found.scene.sparse)
    masks = None
    if found.masks is not None and found.masks.automatic:
        masks = dict(zip(keys, found.masks.masks, strict=True))
    with counting(console, "pictures") as tell:
        count = write_corrected(scene, command.fix, masks=masks, leave_out=left_out, progress=tell)
    said = f", without {', '.join(name for _, name in left_out)}" if left_out else ""
    if masks is not None and (bare := sum(map(len, scene.views.values())) - len(masks)) > 0:
        said += f", and without {bare} photos of other splits, which have no mask"
    say(console, f"a corrected copy of {count} photos is in {command.fix}{said}")


def _write_page(
    found: SceneCheck, command: CheckCommand, following: list[str], console: Console
) -> None:
    from pcore.capture.corrected_copy import check_outside
    from pcore.evaluation.check_page import check_page

    assert command.html is not None, "asked for"
    check_outside(found.scene, command.html)
    write_whole(command.html, check_page(found, following).encode(), "report")
    say(console, f"report with pictures: {command.html}")


def commands_of(found: SceneCheck, command: CheckCommand, factor: int) -> list[str]:
    """What to type next, in the size and with the masks and box that were checked."""
    given = [] if factor == 1 else ["--factor", str(factor)]
    if command.box:
        given += ["--box", *(f"{x:g}" for x in command.box)]
    automatic = found.masks is not None and found.masks.automatic
    masks = command.masks
    if masks is None and (automatic or found.no_masks):
        masks = "auto" if automatic else "trained"
    if masks is not None:
        given += ["--masks", masks]
    uneven = found.quality.drifts or found.quality.odd_exposure
    colour = ["--exposure", "per-view"] if uneven else []
    run = ["-o", f"runs/{found.scene.name}", *given, *colour]
    lines = [["pcore", "train", str(command.scene), *run]]
    if automatic:
        again = ["--masks", "trained"] if masks == "trained" else []
        lines.append(["pcore", "check", str(command.scene), *again, "--masks-out", "masks"])
    return [shlex.join(line) for line in lines]

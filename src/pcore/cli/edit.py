"""`pcore edit ...`: apply, list and check edit files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note, report
from pcore.cli.options import Folder, Number, optional
from pcore.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from pcore.asset.asset import Asset
    from pcore.data.points import PointFile
    from pcore.editing.anchors import AnchorRig
    from pcore.editing.diagnosis import Diagnosis
    from pcore.editing.handles import HandleDiagnosis
    from pcore.editing.script import EditScript
    from pcore.geometry.camera import Camera

_DETAILS = ("region", "freeze")


@dataclass(frozen=True, kw_only=True)
class ApplyCommand:
    """Apply an edit file to the points of a run, write them and say how the edit does."""

    source: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a run, a model.safetensors, or points in a .npy or .ply file."""

    edit: Annotated[Path, arg(metavar="FILE")]
    """Edit file (JSON)."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT")]
    """Where to write the moved points: .npy or .ply. Replaced if it exists."""

    time: Number = None
    """For an edit file with keyframes: the time to apply."""

    colors: Literal["none", "strain", "holes", "handles"] = "none"
    """Colour the points of a .ply. strain: grey calm, red stretched, blue squeezed, violet where
    the surface meets itself, yellow where it comes to light and no training view saw it. holes:
    orange where it comes apart. handles, for edits by anchors: teal where no handle is near, brown
    where anchors disagree."""

    picture: Annotated[Path | None, optional("PNG")] = None
    """Also write a PNG of the points in all these colours side by side, seen from three sides, with
    a legend."""

    scene: Folder = None
    """Folder of the scene whose training views tell what was seen; default: that of the run."""

    def run(self) -> None:
        """Do it; raises PcoreError subclasses for what the user can mend."""
        apply_edit(self, Console())


@dataclass(frozen=True, kw_only=True)
class ListCommand:
    """Say what an edit file does, edit by edit."""

    edit: Annotated[Positional[Path], arg(metavar="FILE")]
    """Edit file (JSON)."""

    def run(self) -> None:
        """Print one line for each edit; raises EditError when the file is not valid."""
        from pcore.editing.animation import load_animation

        animation = load_animation(self.edit)
        console = Console()
        for line in lines_of(animation.at(animation.start)):
            say(console, line)
        if animation.end > animation.start:
            span = (
                f"animated from time {animation.start:g} to {animation.end:g}; shown at the start"
            )
            say(console, span)


@dataclass(frozen=True, kw_only=True)
class ValidateCommand:
    """Check an edit file, and that it fits the points of a run."""

    edit: Annotated[Positional[Path], arg(metavar="FILE")]
    """Edit file (JSON)."""

    run_or_file: Annotated[Path | None, arg(name="run", metavar="RUN", help_behavior_hint="")] = (
        None
    )
    """Folder of a run, a model.safetensors, or points (.npy, .ply) that it is to fit."""

    frames: Annotated[int, arg(metavar="N")] = 60
    """With --run, for a file with keyframes: check it at all keys and at so many times evenly from
    the first to the last, as `pcore animate` takes them."""

    def run(self) -> None:
        """Print that it is valid; raises EditError otherwise."""
        validate_edit(self, Console())


def validate_edit(command: ValidateCommand, console: Console) -> None:
    """Check an edit file, bind it at every time that matters, and say what is odd."""
    from pcore.editing.animation import load_animation

    animation = load_animation(command.edit)
    count = len(animation.at(animation.start).edits)
    what = f"{command.edit}: valid, {count} edit{'s' * (count != 1)}"
    if command.run_or_file is None:
        say(console, what)
        return
    subject = read_subject(command.run_or_file)
    points, rig = subject.points, subject.rig
    times = animation.times_to_check(command.frames)
    notes: list[str] = []
    with counting(console, "times checked") as tell:
        for number, time in enumerate(times, start=1):
            notes += animation.at(time).bound(points, rig=rig).notes
            if len(times) > 1:
                tell(number, len(times))
    what += f"; fits the {len(points):,} points of {command.run_or_file}"
    say(console, what)
    note(console, notes)


def apply_edit(command: ApplyCommand, console: Console) -> None:
    """Move the points, write them, print what happened."""
    from pcore.asset.posing import script_of
    from pcore.cli.edit_results import write_picture
    from pcore.data.points import save_moved, save_points
    from pcore.editing.diagnosis import diagnose, with_exposed
    from pcore.editing.handles import handles_of

    _check_outputs(command)
    script = script_of(command.edit, command.time)
    subject = read_subject(command.source)
    source, points, rig = subject.file, subject.points, subject.rig
    bound = script.bound(points, rig=rig)
    moved = bound.setting.points.to(points.dtype)
    found = diagnose(points, moved)
    cameras, why_not = subject.training_cameras(command.scene)
    if cameras:
        found = with_exposed(found, points, moved, cameras)
    handles = handles_of(script, points, rig)
    colors = _colors(found, handles)
    if command.colors not in ("none", *colors):
        raise InputError(
            f"--colors {command.colors}: expected an edit by anchors in {command.edit}, got none"
        )
    left: tuple[str, ...] = ()
    if command.colors == "none":
        maps = bound.deformation.jacobian(points) if source.has_normals else None
        left = save_moved(command.output, source, moved, maps)
    else:
        save_points(command.output, moved, colors[command.colors], source.faces)
        left = source.not_written()
    for line in [*lines_of(script), *report(points, moved, found, handles, why_not)]:
        say(console, line)
    note(console, [*bound.notes, *source.notes, *left])
    if command.picture is not None:
        write_picture(command.picture, moved, colors)
    say(console, f"written to {command.output}")


def _check_outputs(command: ApplyCommand) -> None:
    from pcore.data.points import check_point_path

    check_point_path(command.output)
    if command.colors != "none" and command.output.suffix.lower() != ".ply":
        raise InputError(f"{command.output}: expected a .ply for --colors, a .npy has no colours")
    if command.picture is not None and command.picture.suffix.lower() != ".png":
        raise InputError(f"{command.picture}: expected a picture that ends in .png")


def _colors(found: Diagnosis, handles: dict[int, HandleDiagnosis]) -> dict[str, Tensor]:
    """Colours of the points by what they show; handles only where an edit has some."""
    from pcore.editing.handles import handle_colors

    colors = {"strain": found.colors(), "holes": found.hole_colors()}
    if handles:
        colors["handles"] = handle_colors(handles.values(), len(found.strain))
    return colors


def read_subject(path: Path) -> Subject:
    """What an edit is of: a run, a model, or the points of a file."""
    from pcore.asset.saving import load
    from pcore.data.points import POINT_SUFFIXES, PointFile, read_point_file

    if path.suffix.lower() in POINT_SUFFIXES:
        return Subject(file=read_point_file(path))
    asset = load(path)
    return Subject(file=PointFile(positions=asset.points), asset=asset)


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """A file of points to edit, or the points of an asset; None for bare points."""

    file: PointFile
    asset: Asset | None = None

    @property
    def points(self) -> Tensor:
        """(N, 3) what is edited, world units."""
        return self.file.positions

    @property
    def rig(self) -> AnchorRig | None:
        """Anchors with learned weights."""
        return None if self.asset is None else self.asset.rig

    def training_cameras(self, scene: Path | None) -> tuple[list[Camera], str]:
        """Cameras of the training views, or none and why they are not known.

        Args:
            scene: folder of the scene; None takes the one that the run was trained on.
        """
        from pcore.capture.load import load_scene

        record = None if self.asset is None else self.asset.record
        folder = scene or (None if record is None else record.scene_folder)
        if folder is None:
            run = record is not None and record.path is not None
            why = "the scene of the run is not here" if run else "points alone have no scene"
            return [], f"{why}; give it with --scene"
        found = load_scene(folder, factor=1 if record is None else record.factor)
        return [view.camera for view in found.split("train")], ""


def lines_of(script: EditScript) -> list[str]:
    """Describe a script in one line per edit and frozen region."""
    content: dict[str, Any] = json.loads(script.to_json())
    lines: list[str] = []
    for number, edit in enumerate(content["edits"], start=1):
        own = {key: value for key, value in edit.items() if key not in ("type", *_DETAILS)}
        line = f"{number}. {edit['type']}: {_said(own)}"
        if edit.get("region"):
            line += f"; in a {_region(edit['region'])}"
        for region in edit.get("freeze", []):
            line += f"; not in a {_region(region)}"
        lines.append(line)
    lines += [f"frozen: {_region(region)}" for region in content.get("freeze", [])]
    return lines or ["no edit"]


def _region(region: dict[str, Any]) -> str:
    rest = {key: value for key, value in region.items() if key != "shape"}
    return f"{region['shape']} ({_said(rest)})"


def _said(values: dict[str, Any]) -> str:
    return ", ".join(f"{key} {_value(value)}" for key, value in values.items()) or "no change"


def _value(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."

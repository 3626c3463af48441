"""`pcore edit ...`: edits applied, listed and checked, and the picture of what goes wrong."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.posing import script_of
from pcore.asset.saving import load
from pcore.capture.load import load_scene
from pcore.cli.cameras import OrbitWish, orbit_of_cloud
from pcore.cli.console import counting, say
from pcore.cli.diagnosing import note, report
from pcore.cli.edit import ApplyCommand, ListCommand, ValidateCommand
from pcore.data.points import (
    POINT_SUFFIXES,
    PointFile,
    check_point_path,
    read_point_file,
    save_moved,
    save_points,
)
from pcore.data.splat import point_picture
from pcore.editing.anchors import AnchorRig
from pcore.editing.animation import load_animation
from pcore.editing.diagnosis import HOLE_LEGEND, STRAIN_LEGEND, Diagnosis, diagnose, with_exposed
from pcore.editing.handles import HANDLE_LEGEND, HandleDiagnosis, handle_colors, handles_of
from pcore.editing.script import EditScript
from pcore.errors import InputError
from pcore.evaluation.figures import png_bytes, sheet, with_legend
from pcore.files.atomic import write_atomically
from pcore.geometry.camera import Camera

VIEWS = 3
"""Evenly around the object, so that every side of it is seen by one."""


def write_picture(path: Path, points: Tensor, colors: Mapping[str, Tensor]) -> None:
    """Draw a sheet with a column for each colouring, a row for each view, and a legend.

    Args:
        path: a .png.
        points: (N, 3) where they are now, world units.
        colors: name of a colouring, of those with a legend -> (N, 3) uint8.
    """
    cameras = [camera for _, camera in orbit_of_cloud(points, OrbitWish(count=VIEWS))]
    rows = [
        (
            f"{number * 360 // VIEWS} degrees",
            [point_picture(points, paint, camera).numpy() for paint in colors.values()],
        )
        for number, camera in enumerate(cameras)
    ]
    page = sheet(list(colors), rows, cell=max(cameras[0].width, cameras[0].height))
    legends = {"strain": STRAIN_LEGEND, "holes": HOLE_LEGEND, "handles": HANDLE_LEGEND}
    page = with_legend(page, {name: legends[name] for name in colors})
    write_atomically(path, png_bytes(page))


_DETAILS = ("region", "freeze")


def list_edits(command: ListCommand, console: Console) -> None:
    """Print one line for each edit, and from when to when they are animated."""
    animation = load_animation(command.edit)
    say(console, *lines_of(animation.at(animation.start)))
    if animation.end > animation.start:
        span = f"{animation.start:g} to {animation.end:g}"
        say(console, f"animated from time {span}; shown at the start")


def validate_edit(command: ValidateCommand, console: Console) -> None:
    """Check an edit file, bind it at every time that matters, and say what is odd."""
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
    check_point_path(command.output)
    if command.colors != "none" and command.output.suffix.lower() != ".ply":
        raise InputError(f"{command.output}: expected a .ply for --colors, a .npy has no colours")
    if command.picture is not None and command.picture.suffix.lower() != ".png":
        raise InputError(f"{command.picture}: expected a picture that ends in .png")


def _colors(found: Diagnosis, handles: dict[int, HandleDiagnosis]) -> dict[str, Tensor]:
    """Colours of the points by what they show; handles only where an edit has some."""
    colors = {"strain": found.colors(), "holes": found.hole_colors()}
    if handles:
        colors["handles"] = handle_colors(handles.values(), len(found.strain))
    return colors


def read_subject(path: Path) -> Subject:
    """What an edit is of: a run, a model, or the points of a file."""
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

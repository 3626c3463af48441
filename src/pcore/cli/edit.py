"""`pcore edit ...`: apply, list and check edit files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.options import Folder, Number, optional


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
        from pcore.cli.edit_results import apply_edit

        apply_edit(self, Console())


@dataclass(frozen=True, kw_only=True)
class ListCommand:
    """Say what an edit file does, edit by edit."""

    edit: Annotated[Positional[Path], arg(metavar="FILE")]
    """Edit file (JSON)."""

    def run(self) -> None:
        """Print one line for each edit; raises EditError when the file is not valid."""
        from pcore.cli.edit_results import list_edits

        list_edits(self, Console())


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
        from pcore.cli.edit_results import validate_edit

        validate_edit(self, Console())

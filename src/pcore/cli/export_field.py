"""`pcore compare --export-field DIR`: the field of every state as official codes take it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from pcore.asset.asset import Asset
from pcore.cli.console import say
from pcore.cli.output import pictures_folder
from pcore.data.points import read_point_file
from pcore.evaluation.field_files import own_sources, write_cameras, write_field
from pcore.evaluation.methods import apart
from pcore.evaluation.states import SceneStates, State

CAMERAS_FILE = "cameras.json"
_REST = "rest"


def export_field(
    console: Console,
    folder: Path,
    runs: Sequence[Asset],
    given: Sequence[tuple[str, Path]],
    where: tuple[SceneStates, Sequence[State]],
) -> None:
    """Write points, nodes, meshes and cages at rest and in every state, and the cameras.

    Args:
        console: says what was written.
        folder: new or empty.
        runs: whose own points are moved, where no files are given.
        given: names and files of points in the order of other checkpoints, of meshes and cages.
        where: the scene and the states.
    """
    places, states = where
    pictures_folder(folder, overwrite=None)
    sources = {name: read_point_file(path) for name, path in given}
    if not sources:
        for asset in runs:
            name = apart(asset, runs).replace("/", "-")
            sources |= own_sources(folder / _REST, name, asset, places.scene)
    notes: list[str] = []
    for name, source in sources.items():
        notes += write_field(folder, name, source, states)
        line = f"{name}: {len(source.positions):,} points in {len(states)} states"
        say(console, line)
    write_cameras(folder / CAMERAS_FILE, states)
    for line in notes:
        say(console, f"note: {line}")
    say(console, f"written to {folder}")

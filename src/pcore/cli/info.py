"""`pcore info PATH`: what a run folder, a model file, a scene or an edit file is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.console import say
from pcore.cli.layout import pair_lines, room


@dataclass(frozen=True, kw_only=True)
class InfoCommand:
    """Say what a run is: stage, steps, points, scores; its settings on demand.

    Of a scene: its layout, its photos, and which of them are not used and why. Of an edit file:
    its edits, and what can be done with it. Of a model for `pcore benchmark make`: its clips.
    """

    run_or_file: Annotated[Positional[Path], arg(metavar="RUN|SCENE|FILE")]
    """Folder of a run, its model file, folder of a scene, an edit file (JSON), or a model of a mesh
    (.glb, .gltf, .obj)."""

    settings: bool = False
    """Also print every setting of the network and of the training."""

    def run(self) -> None:
        """Print the table; raises CheckpointError, SceneError or EditError for damaged ones."""
        from pcore.cli.info_rows import rows_of

        console = Console()
        rows = rows_of(self.run_or_file, settings=self.settings)
        say(console, *pair_lines(rows, room(console)))

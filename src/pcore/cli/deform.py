"""`pcore deform`: apply an edit file to bare points, or to the Gaussians of a 3DGS file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pcore.cli.options import Number, optional


@dataclass(frozen=True, kw_only=True)
class DeformCommand:
    """Apply an edit file to a set of points, or to Gaussians, and write what was moved."""

    input: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POINTS")]
    """Points to move: a NumPy array (N, 3) in a .npy file, or the vertices of a .ply. Or Gaussians:
    the .ply of a 3DGS or 2DGS trainer, .splat, .spz, .sog."""

    edit: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """Edit file (JSON); an edit without "extent" takes that of these points, as Blender does."""

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="OUT")]
    """Where to write: .npy or .ply; a PLY of a PLY keeps all that the file holds, and its normals
    are turned. For Gaussians: .ply, .splat or .glb. Replaced if it exists."""

    time: Number = None
    """For an edit file with keyframes: the time to apply."""

    split: Annotated[float | None, optional("TOLERANCE")] = None
    """Gaussians only: split those that the edit bends within themselves by more than this share of
    their thickness, such as 0.3; default: split none."""

    strict: bool = False
    """Refuse an edit that folds space anywhere, as rendering does, instead of only saying so."""

    def run(self) -> None:
        """Move them; raises PcoreError subclasses for what the user can mend."""
        from pcore.cli.deform_gaussians import deform

        deform(self)

"""`pcore sweep PLAN -o DIR`: train, fine-tune and score scenes x settings x seeds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.options import Count, optional


@dataclass(frozen=True, kw_only=True)
class SweepCommand:
    """Run every scene with every setting and every seed of a plan, and gather the results.

    The same command goes on where an interrupted one stopped, and does not repeat what is
    finished. A trial that fails is listed at the end, with exit code 2, and stops no other.
    """

    plan: Annotated[Positional[Path], arg(metavar="PLAN")]
    """YAML file of scenes, settings, seeds and resources; see the guide "Sweeps"."""

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder for trials and tables; new, empty, or of the same sweep."""

    workers: Count = None
    """Trials at a time on this machine, on Ray (extra `cluster`); default: one after another in
    this process."""

    address: Annotated[str | None, optional("HOST:PORT")] = None
    """Of a running Ray cluster that shares its disks with this machine."""

    storage: Annotated[str | None, optional("URL")] = None
    """Mirror trials to this place (s3://BUCKET/FOLDER, file:///FOLDER, any of fsspec), from which
    every machine goes on: for clusters whose machines share scenes and no folder to write to."""

    dry_run: bool = False
    """Check and show the plan, and say how long it will take; trains a few seconds to know."""

    def run(self) -> None:
        """Run the plan; raises PcoreError subclasses for what the user can mend."""
        from pcore.cli.sweep_results import sweep

        sweep(self, Console())

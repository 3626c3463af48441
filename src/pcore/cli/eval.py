"""`pcore eval RUN`: score a run on the true images of its scene, canonical and deformed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.light import LightChoice
from pcore.cli.options import (
    Count,
    Folder,
    Number,
    Output,
    Samples,
    optional,
)
from pcore.cli.runtime import DeviceName
from pcore.cli.torchrun import is_first


@dataclass(frozen=True, kw_only=True)
class EvalCommand:
    """Score a run on test views: canonical, deformed states, or an exact uniform scale.

    Writes images.csv (one line per picture) and summary.json (means and gains), and prints a
    table. A fine-tuned run is compared with the run it was tuned from, each with rays that know
    of the deformation (aware) and with plain ones.
    """

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of the run."""

    scene: Folder = None
    """Folder of the scene; default: the one the run was trained on."""

    state: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]", help_behavior_hint="")] = ()
    """States besides the canonical one: names, `all`, or `scale:S` (any scene; exact truth).
    Default: all; with --edit none."""

    edit: Annotated[tuple[Path, ...], arg(metavar="FILE [FILE ...]", help_behavior_hint="")] = ()
    """Edit files, each a further state without true images: strain, holes, handles, what no view
    saw, and pictures; no PSNR."""

    against: Annotated[str | None, optional("STATE")] = None
    """With --edit: score the edits on the true test images of this state, such as `end` of a
    PAPR-in-Motion pair or a time stamp."""

    time: Number = None
    """For edit files with keyframes: the time to evaluate."""

    baseline: Folder = None
    """Run to compare with; default: the one that a fine-tuned run was tuned from."""

    rays: Literal["aware", "plain", "both"] = "both"
    """Which rays pictures of deformed states are taken with: methods with plain rays are the
    paper's."""

    light: LightChoice = None
    """still: aware rays also with a light that stands still; baked: without. Default: still for
    runs that have a light (`pcore light`)."""

    protocol: Literal["papr", "standard", "both"] = "both"
    """How images are compared: as the original PAPR does, as everybody else does, or both."""

    samples: Samples = None
    """Rays per pixel: 1, 4, 9, ...; default: those of each model."""

    output: Output = None
    """Folder for the results; default: RUN/eval."""

    pictures: bool = False
    """Also write a sheet per test view: truth, baseline and this run, with depth maps."""

    factor: Count = None
    """Down-scaling of the true images; default: that of the training."""

    device: DeviceName = "auto"
    """Where to compute; auto takes a GPU where there is one."""

    threads: Count = None
    """Threads of the CPU; default: all cores."""

    def run(self) -> None:
        """Evaluate; raises PcoreError subclasses for what the user can mend."""
        from pcore.cli.eval_results import evaluate_run

        evaluate_run(self, Console(quiet=not is_first()))

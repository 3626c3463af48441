"""Results of `pcore sweep` in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from pcore.cli.layout import Column, Sheet, print_lines, room, sheet_lines
from pcore.evaluation.tables import shown

if TYPE_CHECKING:
    from pcore.sweep.spread import PairedDifference, Spread, VariantMean
    from pcore.sweep.sweep_trial import Trial, TrialResult

_COLUMNS = (
    ("foreground_psnr", "fg PSNR\ndB", 2, 1),
    ("psnr", "PSNR\ndB", 2, 1),
    ("ssim", "SSIM", 4, 1),
    ("lpips_vgg", "LPIPS\nvgg", 4, 1),
    ("hole_rate", "holes\n%", 2, 100),
    ("depth_error_relative", "depth error\n%", 2, 100),
)
"""Metric, heading, digits, factor; the files have all metrics."""
_SHOWN = "standard"


def write_results(
    folder: Path, trials: Sequence[Trial], results: Sequence[TrialResult]
) -> tuple[list[VariantMean], list[PairedDifference], int]:
    """Gather the scores of the trials that have finished so far, and write the files.

    Returns:
        Means, differences, and how many seeds there are.

    Raises:
        InputError: a trial's results are damaged.
        OSError: a file cannot be written.
    """
    from pcore.sweep.spread import paired_differences, variant_means
    from pcore.sweep.sweep_scores import scores_of
    from pcore.sweep.sweep_tables import write_sweep

    scores = scores_of([one.trial for one in results if one.failed is None])
    means, differences = variant_means(scores), paired_differences(scores)
    write_sweep(folder, results, scores, means, differences, trials=len(trials))
    return means, differences, len({one.seed for one in scores})


def show_results(
    console: Console, folder: Path, trials: Sequence[Trial], results: Sequence[TrialResult]
) -> None:
    """Write the files and print the tables; errors are those of `write_results`."""
    from pcore.sweep.sweep_scores import notes_of

    means, differences, seeds = write_results(folder, trials, results)
    for sheet in (_mean_sheet(means, seeds), _difference_sheet(differences)):
        if sheet.rows:
            print_lines(console, [*sheet_lines(_filled(sheet), room(console)), ""])
    finished = [one.trial for one in results if one.failed is None]
    print_lines(console, [f"note: {note}" for note in notes_of(finished)])
    console.print(Text(f"written to {folder}"), soft_wrap=True)


def show_failures(console: Console, failures: Sequence[TrialResult]) -> None:
    """List failed trials, each with its reason and where its whole output is."""
    from pcore.sweep.sweep_trial import OUTPUT_FILE

    console.print(f"failed: {len(failures)}")
    for one in failures:
        told = f"  {one.trial.name}: {one.failed} ({one.trial.folder / OUTPUT_FILE})"
        console.print(Text(told), soft_wrap=True)


def _mean_sheet(means: Sequence[VariantMean], seeds: int) -> Sheet:
    """Means over scenes where there are any, else of each scene."""
    from pcore.sweep.sweep_plan import ALL

    chosen = [one for one in means if one.protocol == _SHOWN]
    over = {(one.setting, one.method, one.state) for one in chosen if one.scene == ALL}
    rows = tuple(
        ((one.setting, one.method, one.scene, one.state), _figures(one.figures))
        for one in chosen
        if one.scene == ALL or (one.setting, one.method, one.state) not in over
    )
    return Sheet(
        title=f"protocol {_SHOWN}: mean ± standard deviation over {seeds} seeds",
        keys=("setting", "method", "scene", "state"),
        columns=tuple(heading for _, heading, _, _ in _COLUMNS),
        rows=rows,
    )


def _difference_sheet(differences: Sequence[PairedDifference]) -> Sheet:
    rows = tuple(
        (
            (f"{one.setting}: {one.method}", f"{one.against[0]}: {one.against[1]}", one.state),
            _figures(one.figures, sign=True),
        )
        for one in differences
        if one.protocol == _SHOWN
    )
    return Sheet(
        title="paired differences (same scene and seed): mean ± standard deviation over pairs",
        keys=("variant", "minus", "state"),
        columns=tuple(heading for _, heading, _, _ in _COLUMNS),
        rows=rows,
    )


def _filled(sheet: Sheet) -> Sheet:
    """Without columns that say nothing in any row."""
    kept = [k for k in range(len(sheet.columns)) if any(v[k] != shown(None) for _, v in sheet.rows)]
    rows = tuple((keys, tuple(values[k] for k in kept)) for keys, values in sheet.rows)
    return replace(sheet, columns=tuple(sheet.columns[k] for k in kept), rows=rows)


def _figures(figures: Mapping[str, Spread], *, sign: bool = False) -> Column:
    return tuple(_text(figures.get(name), digits, k, sign) for name, _, digits, k in _COLUMNS)


def _text(one: Spread | None, digits: int, factor: float, sign: bool) -> str:
    if one is None:
        return shown(None)
    plus = "+" if sign and one.mean > 0 else ""
    text = plus + shown(factor * one.mean, digits)
    return text if one.spread is None else f"{text} ± {factor * one.spread:.{digits}f}"

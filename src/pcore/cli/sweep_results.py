"""Results of `pcore sweep` in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from pcore.cli.console import say
from pcore.cli.layout import Column, Sheet, room, sheet_lines
from pcore.evaluation.tables import shown
from pcore.sweep.spread import (
    PairedDifference,
    Spread,
    VariantMean,
    paired_differences,
    variant_means,
)
from pcore.sweep.sweep_plan import ALL
from pcore.sweep.sweep_scores import notes_of, scores_of
from pcore.sweep.sweep_tables import write_sweep
from pcore.sweep.sweep_trial import OUTPUT_FILE, Trial, TrialResult

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
    console: Console, folder: Path, trials: Sequence[Trial], results: Sequence[TrialResult]
) -> None:
    """Gather the scores of finished trials, write the files and print the tables."""
    failed = {one.trial.name for one in results if one.failed is not None}
    finished = [one for one in trials if one.name not in failed]
    scores = scores_of(finished)
    means, differences = variant_means(scores), paired_differences(scores)
    write_sweep(folder, results, scores, means, differences)
    seeds = len({one.seed for one in scores})
    for sheet in (_mean_sheet(means, seeds), _difference_sheet(differences)):
        if sheet.rows:
            say(console, *sheet_lines(_filled(sheet), room(console)), "")
    say(console, *[f"note: {note}" for note in notes_of(finished)])
    say(console, f"written to {folder}")


def show_failures(console: Console, failures: Sequence[TrialResult]) -> None:
    """List failed trials, each with its reason and where its whole output is."""
    say(console, f"failed: {len(failures)}")
    for one in failures:
        told = f"  {one.trial.name}: {one.failed} ({one.trial.folder / OUTPUT_FILE})"
        say(console, told)


def _mean_sheet(means: Sequence[VariantMean], seeds: int) -> Sheet:
    """Means over scenes where there are any, else of each scene."""
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

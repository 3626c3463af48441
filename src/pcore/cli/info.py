"""`pcore info PATH`: what a run folder, a model file, a scene or an edit file is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

from rich.console import Console
from tyro.conf import Positional, arg

from pcore.cli.layout import pair_lines, print_lines, room

if TYPE_CHECKING:
    from pcore.files.gaussian_file import GaussianSummary
    from pcore.files.model_file import ModelSummary
    from pcore.files.run_record import RunRecord
    from pcore.files.skinning_file import SkinningSummary

Rows = list[tuple[str, str]]

_SETTINGS = ("papr.", "config.", "skinning.", "made_by")
"""How names of settings begin."""


@dataclass(frozen=True, kw_only=True)
class InfoCommand:
    """Say what a run is: stage, steps, points, scores; its settings on demand.

    Of a scene: its layout, its photos, and which of them are not used and why. Of an edit file:
    its edits, and what can be done with it.
    """

    run_or_file: Annotated[Positional[Path], arg(metavar="RUN|SCENE|FILE")]
    """Folder of a run, its model file, folder of a scene, or an edit file (JSON)."""

    settings: bool = False
    """Also print every setting of the network and of the training."""

    def run(self) -> None:
        """Print the table; raises CheckpointError, SceneError or EditError for damaged ones."""
        from pcore.cli.scene_rows import is_scene, scene_rows

        console, path = Console(), self.run_or_file
        if path.suffix.lower() == ".json" and path.is_file():
            rows = _edit_rows(path)
        else:
            rows = scene_rows(path) if is_scene(path) else describe(path)
        if not self.settings:
            short = [row for row in rows if not row[0].startswith(_SETTINGS)]
            if len(short) < len(rows):
                short.append(("settings", f"{len(rows) - len(short)}, listed with --settings"))
            rows = short
        print_lines(console, pair_lines(rows, room(console)))


def describe(path: Path) -> Rows:
    """Return name and value of all there is to say about a run folder or model file.

    Raises:
        CheckpointError: there is neither, or what is there is damaged.
    """
    from pcore.asset.asset_summary import summarize

    summary = summarize(path)
    rows: Rows = []
    if summary.record is not None:
        rows += _run_rows(path, summary.record, summary.saved_step)
    if summary.gaussians is not None:
        rows += _gaussian_rows(summary.model_file, summary.gaussians)
    elif summary.model is None:
        rows.append(("model", "none saved yet"))
    else:
        rows += _model_rows(summary.model_file, summary.model)
    if summary.skinning is not None:
        rows += _skinning_rows(summary.skinning)
    if summary.light is not None:
        rows.append(("light", summary.light))
    if summary.record is None:
        return rows
    return [*rows, *_score_rows(path / "eval"), *_flat(summary.record.config, "config.")]


def _run_rows(path: Path, record: RunRecord, saved_step: int | None) -> Rows:
    rows = [("run", str(path)), ("stage", record.stage), ("scene", record.scene)]
    notes = {**record.notes}
    if notes.get("status") in ("running", "stopped"):
        notes["status"] = _unfinished(path, saved_step)
    return rows + _flat(notes)


def _unfinished(path: Path, saved_step: int | None) -> str:
    """How a training stands that has not come to its end; its process may have been killed."""
    from pcore.files.lock import held

    if held(path):
        return "running" if saved_step is None else f"running; step {saved_step} is saved"
    if saved_step is None:
        return "stopped before anything was saved; give the same command again"
    return f"stopped; go on from step {saved_step} with the same command and --resume"


def _edit_rows(path: Path) -> Rows:
    """What an edit file does, and what to do with it."""
    from pcore.cli.edit import lines_of
    from pcore.editing.animation import load_animation

    animation = load_animation(path)
    still = animation.end == animation.start
    lines = lines_of(animation.at(animation.start))
    rows: Rows = [("edit file", str(path))]
    rows += [("" if number else "does", line) for number, line in enumerate(lines)]
    if not still:
        rows.append(("keyframes", f"from time {animation.start:g} to {animation.end:g}"))
    verb = (
        f"pcore render RUN --edit {path}"
        if still
        else f"pcore animate RUN --edit {path} -o film.mp4"
    )
    apply = f"pcore edit apply RUN --edit {path} -o moved.ply --picture health.png"
    return [*rows, ("pictures", verb), ("points, and how it does", apply)]


def _score_rows(folder: Path) -> Rows:
    """PSNR of the object by method and state, where `pcore eval` left its summary."""
    from pcore.evaluation.protocol import STANDARD
    from pcore.evaluation.tables import SUMMARY_FILE, read_summary

    if not (folder / SUMMARY_FILE).is_file():
        return []
    means, _ = read_summary(folder / SUMMARY_FILE)
    means = [one for one in means if one.protocol == STANDARD.name]
    return [
        (
            f"object PSNR, {method}",
            ", ".join(
                f"{one.state} {one.scores['foreground_psnr']:.2f} dB"
                for one in means
                if one.method == method and "foreground_psnr" in one.scores
            ),
        )
        for method in dict.fromkeys(one.method for one in means)
    ]


def _model_rows(path: Path, summary: ModelSummary) -> Rows:
    from pcore.files.records import to_dict

    came, size = summary.provenance, path.stat().st_size / 1e6
    lower, upper = (", ".join(f"{x:.3g}" for x in corner) for corner in came.extent)
    return [
        ("model", f"{path} ({size:.1f} MB, {summary.parameters:,} numbers)"),
        ("made by", f"{came.stage}, {came.step} steps, pcore {came.pcore}"),
        ("trained on", came.scene),
        ("points", f"{summary.points:,}"),
        ("extent", f"({lower}) to ({upper}), world units"),
        *_flat(to_dict(summary.config), "papr."),
    ]


def _gaussian_rows(path: Path, summary: GaussianSummary) -> Rows:
    from pcore.files.records import to_dict

    came = summary.provenance
    lower, upper = (", ".join(f"{x:.3g}" for x in corner) for corner in came.extent)
    return [
        ("model", f"{path} ({path.stat().st_size / 1e6:.1f} MB)"),
        ("made by", f"{came.stage}, {came.step} steps, pcore {came.pcore}"),
        ("trained on", came.scene),
        ("Gaussians", f"{summary.count:,}"),
        ("degree of the harmonics", str(summary.degree)),
        ("extent", f"({lower}) to ({upper}), world units"),
        *_flat(to_dict(summary.footprint), "footprint."),
    ]


def _skinning_rows(summary: SkinningSummary) -> Rows:
    from pcore.files.records import to_dict

    return [
        ("skinning", f"learned weights of {summary.anchors} anchors"),
        *_flat(to_dict(summary.config), "skinning."),
    ]


def _flat(values: Mapping[str, Any], prefix: str = "") -> Rows:
    """Return nested values as rows named by dotted keys."""
    rows: Rows = []
    for key, value in values.items():
        if isinstance(value, dict):
            rows += _flat(cast("dict[str, Any]", value), f"{prefix}{key}.")
        elif isinstance(value, float):
            rows.append((f"{prefix}{key}", f"{value:.6g}"))
        else:
            rows.append((f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value)))
    return rows

"""What `pcore info` says of a run, a model, a scene or an edit file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from shlex import quote
from typing import Any, cast

import numpy as np

from pcore.asset.asset_summary import summarize
from pcore.benchmark.model import read_model
from pcore.capture.layouts import PHOTOS, VIDEO, layouts_of
from pcore.capture.load import load_scene
from pcore.cli.edit_results import lines_of
from pcore.data.scene import Scene, View
from pcore.editing.animation import load_animation
from pcore.evaluation.protocol import STANDARD
from pcore.evaluation.tables import SUMMARY_FILE, read_summary
from pcore.files.gaussian_file import GaussianSummary
from pcore.files.lock import held
from pcore.files.manifest import MANIFEST_FILE
from pcore.files.model_file import ModelSummary
from pcore.files.records import to_dict
from pcore.files.run_record import RunRecord
from pcore.files.skinning_file import SkinningSummary
from pcore.geometry.object_region import coordinates


def is_scene(path: Path) -> bool:
    """Whether something lies there that `load_scene` has a reader for, and no run."""
    if not path.is_dir() or (path / MANIFEST_FILE).is_file():
        return False
    return bool(layouts_of(path)) or (path / "start" / "transforms_train.json").is_file()


def scene_rows(path: Path) -> list[tuple[str, str]]:
    """Name and value of all there is to say about a scene."""
    unposed = [one for one in layouts_of(path) if one.name in (PHOTOS, VIDEO)]
    if unposed:
        return [
            ("scene", str(path)),
            ("layout", f"{unposed[0].name}, without poses"),
            ("poses", "found by COLMAP when it is trained (extra `colmap`)"),
        ]
    scene = load_scene(path)
    views = [view for split in scene.views.values() for view in split]
    rows = [
        ("scene", str(path)),
        ("layout", scene.layout),
        ("views", ", ".join(f"{len(found)} {name}" for name, found in scene.views.items())),
        ("sizes", _counted(f"{v.camera.width} x {v.camera.height}" for v in views)),
        ("lenses", _lenses(views)),
        ("masks", _counted(map(_mask, views))),
        ("sparse points", _points(scene)),
        ("region", _region(scene)),
        ("states", ", ".join(scene.states) or "none"),
        ("not used", f"{len(scene.skipped)} photos"),
    ]
    rows += [(f"not used: {one.name}", one.reason) for one in scene.skipped]
    return rows + [("note", note) for note in scene.notes]


def _counted(values: Iterable[str]) -> str:
    counts = Counter(values)
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{value} ({count} views)" for value, count in counts.most_common(8))


def _mask(view: View) -> str:
    alpha = "alpha channel" if view.image.header.has_alpha else "none"
    return "mask file" if view.image.mask else alpha


def _lenses(views: list[View]) -> str:
    bent = sum(view.image.lens is not None for view in views)
    return f"{bent} of {len(views)} views are straightened" if bent else "pinhole"


def _points(scene: Scene) -> str:
    sparse = scene.sparse
    if sparse is None:
        return "none"
    error = "" if sparse.errors is None else f", mean error {float(sparse.errors.mean()):.2f} px"
    return f"{len(sparse):,}{error}"


def _region(scene: Scene) -> str:
    region = scene.region
    if region is None:
        return "not said by the files"
    return f"radius {region.radius:.4g} about ({coordinates(region.center, region.radius)})"


Rows = list[tuple[str, str]]


_SETTINGS = ("papr.", "config.", "skinning.", "made_by")


"""How names of settings begin."""


def rows_of(path: Path, *, settings: bool) -> Rows:
    """Name and value of what is to be said; settings of networks and trainings on demand."""
    suffix = path.suffix.lower() if path.is_file() else ""
    if suffix == ".json":
        return _edit_rows(path)
    if suffix in (".glb", ".gltf", ".obj"):
        return _mesh_rows(path)
    rows = scene_rows(path) if is_scene(path) else describe(path)
    short = [row for row in rows if not row[0].startswith(_SETTINGS)]
    if settings or len(short) == len(rows):
        return rows
    return [*short, ("settings", f"{len(rows) - len(short)}, listed with --settings")]


def describe(path: Path) -> Rows:
    """Return name and value of all there is to say about a run folder or model file."""
    summary = summarize(path)
    rows: Rows = []
    if summary.record is not None:
        rows += _run_rows(path, summary.record, summary.saved_step)
    made = summary.gaussians or summary.model
    rows += _model_rows(summary.model_file, made) if made else [("model", "none saved yet")]
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
    if held(path):
        return "running" if saved_step is None else f"running; step {saved_step} is saved"
    if saved_step is None:
        return "stopped before anything was saved; give the same command again"
    return f"stopped; go on from step {saved_step} with the same command and --resume"


def _edit_rows(path: Path) -> Rows:
    """What an edit file does, and what to do with it."""
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


def _mesh_rows(path: Path) -> Rows:
    """What a benchmark can be made of."""
    model = read_model(path)
    size = " x ".join(f"{side:.4g}" for side in np.ptp(model.vertices, axis=0))
    used = [model.look.materials[k] for k in np.unique(model.look.material_of_face).tolist()]
    painted = sum(one.texture is not None for one in used)
    rows: Rows = [
        ("model", str(path)),
        ("mesh", f"{len(model.vertices):,} vertices, {len(model.faces):,} triangles"),
        ("size", f"{size} units of the file, z up"),
        ("materials", f"{len(used)}, {painted} with a texture"),
    ]
    for clip in model.clips:
        first, last = clip.span
        rows.append(("clip", f"{clip.name}: {first:g} to {last:g} seconds"))
    return [*rows, ("benchmark", f"pcore benchmark make {quote(str(path))} -o bench")]


def _score_rows(folder: Path) -> Rows:
    """PSNR of the object by method and state, where `pcore eval` left its summary."""
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


def _model_rows(path: Path, summary: ModelSummary | GaussianSummary) -> Rows:
    came, more = summary.provenance, ""
    lower, upper = (", ".join(f"{x:.3g}" for x in corner) for corner in came.extent)
    if isinstance(summary, ModelSummary):
        more = f", {summary.parameters:,} numbers"
        own = [("points", f"{summary.points:,}")]
        settings = _flat(to_dict(summary.config), "papr.")
    else:
        own = [("Gaussians", f"{summary.count:,}")]
        own.append(("degree of the harmonics", str(summary.degree)))
        settings = _flat(to_dict(summary.footprint), "footprint.")
    return [
        ("model", f"{path} ({path.stat().st_size / 1e6:.1f} MB{more})"),
        ("made by", f"{came.stage}, {came.step} steps, pcore {came.pcore}"),
        ("trained on", came.scene),
        *own,
        ("extent", f"({lower}) to ({upper}), world units"),
        *settings,
    ]


def _skinning_rows(summary: SkinningSummary) -> Rows:
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

"""Make a benchmark of a model: canonical views, and for every state true pictures and the true map.

The layout is that of the evaluation sets and of the embedded sample: a NeRF-Synthetic scene with a
folder for each state, `deformation.json` in it, and all meshes in one vertex order in
`meshes.npz`. Depth and normals lie beside the pictures, in `SPLIT_geometry`.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pcore.benchmark.blender_renderer import blender
from pcore.benchmark.look import FloatArray
from pcore.benchmark.model import Model
from pcore.benchmark.model_states import (
    CAMERA_RADIUS,
    BenchmarkPlan,
    State,
    canonical_shape,
    plan_states,
)
from pcore.benchmark.renderers import Job, Renderer, embedded
from pcore.benchmark.true_picture import Shape
from pcore.errors import InputError
from pcore.sample.sample import write_json, write_views
from pcore.sample.sample_render import camera_poses, sample_surface, seen_samples
from pcore.sample.sample_states import ANGLE_X

Progress = Callable[[int, int], None]
SPLITS = {
    "train": {"radius": CAMERA_RADIUS, "highest": 0.97, "phase": 0.0},
    "test": {"radius": CAMERA_RADIUS, "highest": 0.93, "phase": 1.234},
}
"""Where the cameras of a split stand, as `camera_poses` takes it."""
_SAMPLES = 50_000
MANIFEST = "scene.json"
"""Says what a benchmark was made of."""


def make_benchmark(
    folder: Path, model: Model, plan: BenchmarkPlan, *, progress: Progress | None = None
) -> tuple[str, ...]:
    """Write the benchmark; the folder appears whole or not at all.

    Args:
        folder: to make; must not exist, or be empty.
        model: what to show.
        plan: how much of it.
        progress: told (pictures done, pictures in all).

    Returns:
        What was left out, in sentences.

    Raises:
        DependencyError: the extra `sample` (embreex) is not installed, or no Blender.
        EditError: an edit that does not fit or folds space.
        InputError: a clip that is not there or does not move, a shape without extent, no states.
        OSError: the folder cannot be written.
    """
    (vertices, center, scale), states, notes = planned(model, plan)
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        made = scratch / "scene"
        _write(made, model, plan, vertices, states, progress)
        _write_manifest(made / MANIFEST, model, plan, (center, scale), states)
        made.replace(folder)
    except OSError as error:
        error.filename = error.filename or str(folder)  # Of a full disk Pillow tells no place.
        raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return tuple(notes)


def planned(
    model: Model, plan: BenchmarkPlan
) -> tuple[tuple[FloatArray, FloatArray, float], dict[str, State], list[str]]:
    """What `canonical_shape` and `plan_states` make of a model, with all their errors.

    Raises:
        InputError: also where there are no states.
    """
    canonical = canonical_shape(model, plan)
    states, notes = plan_states(model, plan, *canonical)
    if not states:
        raise InputError(
            f"{model.name}: expected at least one state, got none: the file has no clip that "
            "moves; leave out --no-analytic, or give --edits"
        )
    return canonical, states, [*notes, *model.look.left_out()]


def made_already(folder: Path, model: Model, plan: BenchmarkPlan) -> bool:
    """Whether a folder holds the benchmark that `make_benchmark` would write of the same model."""
    try:
        record: dict[str, Any] = json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError):
        return False
    return record.get("made_of") == _made_of(model, plan)


def _made_of(model: Model, plan: BenchmarkPlan) -> str:
    """Hash of all that a benchmark depends on."""
    look, digest = model.look, hashlib.sha256()
    arrays: list[NDArray[Any] | None] = [
        model.vertices,
        model.faces,
        look.material_of_face,
        look.smooth,
        look.colors,
        *look.uv,
    ]
    for material in look.materials:
        texture = material.texture
        digest.update(repr((material.color, material.cutoff)).encode())
        if texture is not None:
            arrays.append(texture.pixels)
            digest.update(repr(replace(texture, pixels=texture.pixels[:0])).encode())
    for clip in model.clips:
        for track in clip.tracks:
            digest.update(repr((clip.name, track.node, track.path, track.interpolation)).encode())
            arrays += [track.times, track.values]
    for array in arrays:
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    if model.glb is not None:
        # Skins, morph targets and poses of nodes, of which the shapes of its clips are made.
        digest.update(json.dumps(model.glb.data, sort_keys=True).encode())
        digest.update(model.glb.binary)
    edits = [(name, script.to_json()) for name, script in plan.edits]
    digest.update(repr((replace(plan, edits=()), edits)).encode())
    return digest.hexdigest()


def _write(
    folder: Path,
    model: Model,
    plan: BenchmarkPlan,
    vertices: FloatArray,
    states: dict[str, State],
    progress: Progress | None,
) -> None:
    train = camera_poses(plan.train_views, **SPLITS["train"])
    test = camera_poses(plan.test_views, **SPLITS["test"])
    canonical = Shape.of(vertices, model.faces, model.look)
    renderer = _renderer(model, plan, canonical)
    jobs: list[Job] = []
    for split, poses in (("train", train), ("test", test)):
        jobs += _views(folder, split, poses, ANGLE_X, canonical)
    for name, state in states.items():
        shape = Shape.of(state.vertices, model.faces, model.look)
        jobs += _views(folder / name, "test", test, state.angle_x, shape)
        if plan.state_train_views:
            learned = camera_poses(
                plan.state_train_views, radius=CAMERA_RADIUS, highest=0.97, phase=0.0
            )
            jobs += _views(folder / name, "train", learned, state.angle_x, shape)
        write_json(folder / name / "deformation.json", state.description)
    _take_all(jobs, renderer, progress)
    _write_meshes(folder / "meshes.npz", model, plan, canonical, states, train)


def _take_all(jobs: Sequence[Job], renderer: Renderer, progress: Progress | None) -> None:
    for folder in dict.fromkeys(job.path.parent for job in jobs):
        folder.mkdir(parents=True, exist_ok=True)
        folder.with_name(f"{folder.name}_geometry").mkdir(exist_ok=True)
    shown = False
    for done, (job, shot) in enumerate(zip(jobs, renderer(jobs), strict=True), start=1):
        shown = shown or bool(shot.rgba[..., 3].any())
        Image.fromarray(shot.rgba).save(job.path)
        geometry = job.path.parent.with_name(f"{job.path.parent.name}_geometry")
        np.savez_compressed(geometry / f"{job.path.stem}.npz", depth=shot.depth, normal=shot.normal)
        if progress is not None:
            progress(done, len(jobs))
    if not shown:
        raise InputError(
            "benchmark: expected a model that is to be seen, got empty pictures: all of it is cut "
            "out by its alpha; make its materials opaque"
        )


def _renderer(model: Model, plan: BenchmarkPlan, canonical: Shape) -> Renderer:
    baked = plan.light == "baked"
    if plan.renderer == "embedded":
        return embedded(model.look, resolution=plan.resolution, lit=canonical if baked else None)
    if baked:
        raise InputError(
            "--renderer blender: expected --light fixed, got baked, which only the embedded "
            "renderer has; leave out one of them"
        )
    return blender(model.look, resolution=plan.resolution)


def _views(folder: Path, split: str, poses: FloatArray, angle_x: float, shape: Shape) -> list[Job]:
    write_views(folder, split, poses, angle_x)
    return [
        Job(path=folder / split / f"r_{i}.png", shape=shape, pose=pose, angle_x=angle_x)
        for i, pose in enumerate(poses)
    ]


def _write_meshes(
    path: Path,
    model: Model,
    plan: BenchmarkPlan,
    canonical: Shape,
    states: dict[str, State],
    poses: FloatArray,
) -> None:
    face, weights = sample_surface(canonical.caster, _SAMPLES, plan.seed)
    seen = seen_samples(canonical.caster, face, weights, poses, angle_x=ANGLE_X)
    cut: dict[str, NDArray[Any]] = {}
    if model.look.has_holes:
        cut = {"cut_out": model.look.cut_out(model.faces)}
        seen &= ~model.look.passes(face, model.look.rgba(model.faces, face, weights)[:, 3])
    arrays: dict[str, NDArray[Any]] = {
        # Doubles: the maps are exact to the last digits of the model.
        "canonical": canonical.caster.vertices,
        "faces": model.faces.astype(np.int32),
        "sample_face": face,
        "sample_barycentric": weights,
        "sample_visible": seen,
        **cut,
        **{name: state.vertices for name, state in states.items()},
    }
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _write_manifest(
    path: Path,
    model: Model,
    plan: BenchmarkPlan,
    frame: tuple[FloatArray, float],
    states: dict[str, State],
) -> None:
    content = {
        "generator": "pcore benchmark make",
        "version": 1,
        "name": model.name,
        "vertices": len(model.vertices),
        "triangles": len(model.faces),
        "resolution": plan.resolution,
        "light": plan.light,
        "renderer": plan.renderer,
        "normalisation": {
            "centre": frame[0].tolist(),
            "scale": frame[1],
            "rule": "p -> (p - centre) * scale of the model with z up; centre: of the canonical "
            "bounding box; largest vertex norm 1",
        },
        "camera_radius": CAMERA_RADIUS,
        "camera_angle_x": ANGLE_X,
        "canonical_pose": None if plan.canonical is None else list(plan.canonical),
        "states": {name: state.description for name, state in states.items()},
        "made_of": _made_of(model, plan),
    }
    write_json(path, content)

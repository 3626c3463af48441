"""The embedded sample: a toy snail with true renderings of its deformed states, made on the spot.

The files have the layout of a NeRF-Synthetic scene with deformed states: canonical views, and for
every state its own test views, `deformation.json`, and the true meshes in `meshes.npz`.

Light is baked into the canonical surface and moves with it: a deformed state shows every surface
point in its canonical colour. That is what a method that moves points and keeps their features
can get right; re-lighting would be an error that no geometry could avoid.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from pcore.errors import SceneError
from pcore.sample.sample_mesh import PaintedMesh, snail
from pcore.sample.sample_render import (
    MeshCaster,
    camera_poses,
    ray_caster_class,
    render_rgba,
    sample_surface,
    seen_samples,
)
from pcore.sample.sample_states import ANGLE_X, DeformedState, deformed_states, describe_state
from pcore.validation import check_count

Array = NDArray[Any]
Progress = Callable[[int, int], None]

MANIFEST = "scene.json"
_GENERATOR, _VERSION = "pcore sample snail", 1
_RADIUS = 4.0
_SEED, _SAMPLES = 0, 20_000


def make_sample(
    root: str | Path,
    *,
    resolution: int = 100,
    train_views: int = 60,
    test_views: int = 10,
    progress: Progress | None = None,
) -> Path:
    """Write the embedded sample, or find it there already.

    The same arguments give the same files. The folder appears whole or not at all: it is
    written beside its place and renamed. States: `twist60`, `bend60`, `stretch` (Blender's
    profile, factor 0.6) and `scale2x`, which has its own field of view.

    Args:
        root: folder to make.
        resolution: pixels along each side of every image.
        train_views: canonical training views.
        test_views: test views, canonical and of every state.
        progress: called with (images done, images in all).

    Returns:
        The folder, ready for `load_scene`.

    Raises:
        DependencyError: the extra `sample` is not installed.
        SceneError: the folder holds something else, or cannot be written.
    """
    settings = {
        "resolution": check_count("resolution", resolution, minimum=8),
        "train_views": check_count("training views", train_views, minimum=2),
        "test_views": check_count("test views", test_views),
    }
    folder = Path(root)
    if _is_there(folder, settings):
        return folder
    ray_caster_class()  # before any work, so that a missing extra is said at once
    _write_whole(folder, settings, progress)
    return folder


def _is_there(folder: Path, settings: dict[str, int]) -> bool:
    """Whether the folder holds this very sample; SceneError when it holds anything else."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    wanted = {"generator": _GENERATOR, "version": _VERSION, **settings}
    try:
        found = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    manifest: dict[str, Any] = found if isinstance(found, dict) else {}
    present = {key: manifest.get(key) for key in wanted}
    if present == wanted:
        return True
    got = present if manifest.get("generator") == _GENERATOR else "other files"
    raise SceneError(
        f"sample {folder}: expected an empty place or the sample with {wanted}, got {got}; "
        "choose another folder or remove this one"
    )


def _write_whole(folder: Path, settings: dict[str, int], progress: Progress | None) -> None:
    """Write beside the folder and rename; nothing is left behind when it fails."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as problem:
        raise SceneError(f"sample {folder}: cannot be written ({problem})") from problem
    try:
        _write_scene(scratch / "scene", settings, progress)
        _move_into_place(scratch / "scene", folder, settings)
    except OSError as problem:
        raise SceneError(f"sample {folder}: cannot be written ({problem})") from problem
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _move_into_place(made: Path, folder: Path, settings: dict[str, int]) -> None:
    try:
        # Replaces an empty folder, refuses one that has content.
        made.replace(folder)
    except OSError:
        # Another process may have finished the same sample in the meantime.
        if not folder.exists() or not _is_there(folder, settings):
            raise


def _write_scene(folder: Path, settings: dict[str, int], progress: Progress | None) -> None:
    mesh = snail()
    states = deformed_states(mesh.vertices)
    train = camera_poses(settings["train_views"], radius=_RADIUS, highest=0.97, phase=0.0)
    test = camera_poses(settings["test_views"], radius=_RADIUS, highest=0.93, phase=1.234)
    total = len(train) + (1 + len(states)) * len(test)
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    size = settings["resolution"]
    canonical = MeshCaster(mesh.vertices, mesh.faces)
    for split, poses in (("train", train), ("test", test)):
        write_views(folder, split, poses, ANGLE_X)
        _write_images(folder / split, canonical, mesh.colors, poses, (ANGLE_X, size), tick)
    moved: dict[str, Array] = {}
    for name, state in states.items():
        vertices = state.deformation(torch.from_numpy(mesh.vertices)).numpy()
        moved[name] = vertices
        caster = MeshCaster(vertices, mesh.faces)
        write_views(folder / name, "test", test, state.angle_x)
        view = (state.angle_x, size)
        _write_images(folder / name / "test", caster, mesh.colors, test, view, tick)
        write_json(
            folder / name / "deformation.json", describe_state(state, mesh.vertices, vertices)
        )
    _write_meshes(folder / "meshes.npz", mesh, moved, canonical, train)
    _write_manifest(folder / MANIFEST, settings, mesh, states)


def write_views(folder: Path, split: str, poses: Array, angle_x: float) -> None:
    """Write the cameras of a split, poses (C, 4, 4), as a NeRF-Synthetic scene names them."""
    frames = [
        {"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()}
        for i, pose in enumerate(poses)
    ]
    content = {"camera_angle_x": angle_x, "frames": frames}
    write_json(folder / f"transforms_{split}.json", content)


def _write_images(
    folder: Path,
    caster: MeshCaster,
    colors: Array,
    poses: Array,
    view: tuple[float, int],
    tick: Callable[[], None],
) -> None:
    folder.mkdir(parents=True)
    for i, pose in enumerate(poses):
        rgba = render_rgba(caster, colors, pose, angle_x=view[0], resolution=view[1])
        Image.fromarray(rgba).save(folder / f"r_{i}.png")
        tick()


def _write_meshes(
    path: Path, mesh: PaintedMesh, moved: dict[str, Array], caster: MeshCaster, poses: Array
) -> None:
    face, weights = sample_surface(caster, _SAMPLES, _SEED)
    arrays: dict[str, Any] = {
        "canonical": mesh.vertices.astype(np.float32),
        "faces": mesh.faces,
        "sample_face": face,
        "sample_barycentric": weights,
        "sample_visible": seen_samples(caster, face, weights, poses, angle_x=ANGLE_X),
        **{name: vertices.astype(np.float32) for name, vertices in moved.items()},
    }
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _write_manifest(
    path: Path, settings: dict[str, int], mesh: PaintedMesh, states: dict[str, DeformedState]
) -> None:
    content = {
        "generator": _GENERATOR,
        "version": _VERSION,
        **settings,
        "name": "snail",
        "licence": "CC0",
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "camera_radius": _RADIUS,
        "camera_angle_x": ANGLE_X,
        "canonical_bbox": [mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()],
        "states": {name: state.description for name, state in states.items()},
    }
    write_json(path, content)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write a record, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")

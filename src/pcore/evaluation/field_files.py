"""The field of every state as files: points of any checkpoint, nodes, meshes and cages, moved."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.data.points import PointFile, read_point_file, save_moved, save_points
from pcore.data.scene import Scene
from pcore.errors import EditError
from pcore.evaluation.picture_method import folder_of
from pcore.evaluation.states import CANONICAL, State
from pcore.files.atomic import write_atomically
from pcore.rivals.bound_fit import sized_mesh
from pcore.rivals.cage_mesh import coarse_cage
from pcore.rivals.nodes import node_rig

_TRIANGLES = 4000


def write_field(folder: Path, name: str, source: PointFile, states: Sequence[State]) -> list[str]:
    """Write what a file of points holds in every state, in its order, all else as it is.

    `NAME/STATE.ply` (or .npy, as the source is) and `NAME/STATE-jacobians.npy`, (N, 3, 3) float32,
    rows the places after, columns those before.

    Args:
        folder: made with its parents.
        name: of the points.
        source: what was read: points, a checkpoint of Gaussians, a mesh, a cage.
        states: where they go.

    Returns:
        What is odd, a sentence each: properties that an edit should turn and that are kept, and
        states that fold space at some points.

    Raises:
        InputError: a file cannot be written.
    """
    place = folder / name
    place.mkdir(parents=True, exist_ok=True)
    ending = ".npy" if source.ply is None else ".ply"
    rest = source.positions.double()
    notes: list[str] = []
    for state in states:
        moved = state.move(rest)
        file = place / f"{folder_of(state.name)}{ending}"
        jacobians, why = _jacobians(state, rest, moved)
        kept = save_moved(file, source, moved.to(source.positions), jacobians)
        notes += [f"{file}: {line}" for line in kept]
        if why is not None:
            notes.append(f"{name}, state {state.name}: no Jacobians, {why}")
        if jacobians is not None and state.name != CANONICAL:
            path = place / f"{folder_of(state.name)}-jacobians.npy"
            np.save(path, jacobians.float().numpy(), allow_pickle=False)
    return list(dict.fromkeys(notes))


def _jacobians(state: State, rest: Tensor, moved: Tensor) -> tuple[Tensor | None, str | None]:
    """Jacobians (N, 3, 3) of a state at points, or why there are none."""
    try:
        maps = state.local_maps(rest, moved)
    except EditError as error:
        return None, str(error)
    if maps is None:
        return torch.eye(3, dtype=torch.float64).repeat(len(rest), 1, 1), None
    return torch.linalg.inv(maps.to_rest.double()), None


def own_sources(folder: Path, name: str, asset: Asset, scene: Scene) -> dict[str, PointFile]:
    """Points of a run, and our own nodes, mesh and cage of it where it is made of Gaussians.

    They are written at rest into the folder, so that other codes can be given them; names of the
    files begin with that of the run.

    Raises:
        InputError: the object has no surface.
        DependencyError: scikit-image is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    made: dict[str, tuple[Tensor, Tensor | None]] = {f"{name}-points": (asset.points, None)}
    if isinstance(asset.content, GaussianContent):
        made[f"{name}-nodes"] = (node_rig(asset.content.gaussians).nodes.float(), None)
        with torch.no_grad():
            fused, vertices, faces = sized_mesh(
                lambda camera: asset.render(None, camera), scene, asset.points, _TRIANGLES
            )
        made[f"{name}-mesh"] = (vertices, faces)
        made[f"{name}-cage"] = coarse_cage(fused)
    found: dict[str, PointFile] = {}
    for one, (points, faces) in made.items():
        path = folder / f"{one}.ply"
        save_points(path, points, faces=faces)
        found[one] = read_point_file(path)
    return found


def write_cameras(path: Path, states: Sequence[State]) -> None:
    """Write which picture of which state is taken from where: state, view, camera, size.

    Poses are camera to world, OpenGL axes, world units; intrinsics in pixels.
    """
    views = [
        {
            "state": state.name,
            "picture": f"{folder_of(state.name)}/{shot.view.name}.png",
            "width": shot.camera.width,
            "height": shot.camera.height,
            "fx": float(shot.camera.fx),
            "fy": float(shot.camera.fy),
            "cx": float(shot.camera.cx),
            "cy": float(shot.camera.cy),
            "world_from_camera": shot.camera.world_from_camera.tolist(),
        }
        for state in states
        for shot in state.shots
    ]
    write_atomically(path, json.dumps(views, indent=1).encode())

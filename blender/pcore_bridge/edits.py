"""Edit files out of what was posed in Blender."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .bundle import BridgeError, Bundle, check_points, write_json, write_ply, write_whole
from .keys import reduced, turning
from .scene import (
    ANCHOR,
    CAGE,
    NEAR,
    PIN,
    POINTS,
    PROXY,
    bundle_of,
    frames_of,
    member,
    members,
    place_and_turn,
    place_of,
    rest_places,
    root_of,
    shape_of,
)

_TRUE = 5e-5
"""How far keys may be off what Blender shows at any frame: a share of the size; of a quaternion."""
_EXACT = 5e-7
"""The same for shapes of meshes and points."""


def export_edit(
    context: bpy.types.Context, mode: str, name: str, *, moving: bool
) -> tuple[Path, list[str]]:
    """Write an edit file, and the shapes it names, into the folder of the bundle.

    Args:
        context: of Blender.
        mode: "anchors", "cage", "mesh" or "points".
        name: of the file.
        moving: all frames of the scene, or the one that shows.

    Returns:
        The file, and what the user should know.

    Raises:
        BridgeError: what cannot be brought back, and why.
    """
    if Path(name).name != name or not name.endswith(".json") or name.startswith("."):
        raise BridgeError(f"{name!r}: expected the name of a .json file without a folder")
    root = root_of(context)
    bundle = bundle_of(root)
    if name in {"bundle.json", *bundle.about["files"].values()}:
        raise BridgeError(f"{name}: is a file of the bundle itself; choose another name")
    fps = context.scene.render.fps / context.scene.render.fps_base
    notes = []
    if moving and abs(fps - bundle.about["fps"]) > 1e-3:
        notes.append(f"the scene runs at {fps:g} frames per second, the bundle at "
                     f"{bundle.about['fps']:g}; times are those of the scene")  # fmt: skip
    if mode == "anchors":
        edit = _anchors(context, root, bundle, fps, notes, moving=moving)
    else:
        edit = _shapes(context, root, bundle, mode, Path(name).stem, fps, moving=moving)
    path = bundle.folder / name
    write_json(path, {"version": 2, "edits": [edit]})
    return path, notes


def _anchors(context, root, bundle: Bundle, fps, notes, *, moving) -> dict:
    anchors = members(root, ANCHOR)
    places: list[list[np.ndarray]] = [[] for _ in anchors]
    turns: list[list[np.ndarray]] = [[] for _ in anchors]
    scaled = set()
    for graph in frames_of(context, moving=moving):
        for number, item in enumerate(anchors):
            where = place_and_turn(item.name, place_of(item, root, graph))
            places[number].append(where[0])
            turns[number].append(np.array(Matrix(where[1].tolist()).to_quaternion()))
            if where[2]:
                scaled.add(item.name)
    if scaled:
        notes.append(f"anchors carry no scale; that of {', '.join(sorted(scaled))} is left out")
    slack = 1e-6 * bundle.about["size"]
    handles, named = [], {}
    for item, way, turn in zip(anchors, map(np.array, places), map(np.array, turns), strict=True):
        near = np.array(item[NEAR], dtype=np.float64)
        turned = bool((np.abs(turn[:, 1:]) > 1e-6).any())
        if not turned and not item.get(PIN) and np.abs(way - near).max() <= slack:
            continue
        if tuple(near) in named:
            raise BridgeError(
                f"{item.name} and {named[tuple(near)]} move the same anchor; delete one of them"
            )
        named[tuple(near)] = item.name
        handle = {"near": near.tolist(), "to": _track(way, _TRUE * bundle.about["size"], fps)}
        if turned:
            handle["rotation"] = _track(turn, _TRUE, fps, turning)
        handles.append(handle)
    if not handles:
        raise BridgeError(
            "no anchor has moved: drag or turn one, or give it the property pcore_pin"
        )
    return {"type": "anchors", "handles": handles}


def _shapes(context, root, bundle, mode, stem, fps, *, moving) -> dict:
    role = {"cage": CAGE, "mesh": PROXY, "points": POINTS}[mode]
    item, rest = member(root, role), bundle.mesh(role)
    if mode == "points":
        check_points(bundle, rest_places(item))
    shapes = np.array(
        [shape_of(item, root, graph, rest) for graph in frames_of(context, moving=moving)]
    )
    if np.array_equal(shapes, np.broadcast_to(rest.vertices, shapes.shape)):
        raise BridgeError(f"the {role} has not moved: pose it first")
    kept, files = reduced(shapes, _EXACT * bundle.about["size"]), []
    ending = ".npy" if mode == "points" else ".ply"
    for number, frame in enumerate(kept, start=1):
        file = bundle.folder / f"{stem}_{number:04}{ending}"
        if mode == "points":
            write_whole(file, _npy(shapes[frame]))
        else:
            write_ply(file, shapes[frame], rest.faces)
        files.append(file.name)
    after = files[0] if len(kept) == 1 else _keyed(kept, files, fps)
    kind = "displacement" if mode == "points" else mode
    return {"type": kind, "before": bundle.about["files"][role], "after": after}


def _npy(values: np.ndarray) -> bytes:
    import io

    stream = io.BytesIO()
    np.save(stream, values, allow_pickle=False)
    return stream.getvalue()


def _track(values: np.ndarray, tolerance: float, fps: float, *between) -> object:
    kept = reduced(values, tolerance, *between)
    if len(kept) == 1:
        return values[0].tolist()
    return _keyed(kept, [values[frame].tolist() for frame in kept], fps)


def _keyed(frames: list[int], values: list, fps: float) -> dict:
    return {
        "keyframes": [[frame / fps, value] for frame, value in zip(frames, values, strict=True)]
    }

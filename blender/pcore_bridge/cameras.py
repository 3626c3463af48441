"""Cameras of a bundle into the scene, and the scene's camera into a file that pcore reads."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .bundle import BridgeError, Bundle, write_json
from .scene import bundle_of, frames_of, place_and_turn, place_of, root_of


def add_cameras(root: bpy.types.Object, bundle: Bundle) -> list[bpy.types.Object]:
    """Put the cameras of a bundle under its empty; return them."""
    content, cameras = bundle.json("cameras"), []
    for frame in content["frames"]:
        lens = {**content, **frame}
        width, height = float(lens["w"]), float(lens["h"])
        data = bpy.data.cameras.new(Path(frame["file_path"]).stem)
        longest = max(width, height)
        data.sensor_fit = "HORIZONTAL" if width >= height else "VERTICAL"
        data.sensor_width = data.sensor_height = 36.0
        data.lens = 36.0 * float(lens["fl_x"]) / longest
        data.shift_x = (width / 2 - float(lens["cx"])) / longest
        data.shift_y = (float(lens["cy"]) - height / 2) / longest
        data.display_size = 0.05 * bundle.about["size"]
        data.clip_start, data.clip_end = 1e-3 * bundle.about["size"], 1e3 * bundle.about["size"]
        camera = bpy.data.objects.new(data.name, data)
        camera.parent = root
        camera.matrix_local = Matrix(frame["transform_matrix"])
        root.users_collection[0].objects.link(camera)
        cameras.append(camera)
    return cameras


def export_cameras(context: bpy.types.Context, name: str, *, moving: bool) -> Path:
    """Write the scene's camera at every frame as a transforms file beside the bundle.

    Raises:
        BridgeError: no camera, one of another kind, or pixels that are not square.
    """
    root, scene = root_of(context), context.scene
    bundle = bundle_of(root)
    if Path(name).name != name or not name.endswith(".json") or name in _taken(bundle):
        raise BridgeError(f"{name!r}: expected a name of a new .json file without a folder")
    if scene.camera is None or scene.camera.data.type != "PERSP":
        raise BridgeError("expected an active camera of type Perspective in the scene")
    if scene.render.pixel_aspect_x != scene.render.pixel_aspect_y:
        raise BridgeError("expected square pixels; set both aspects of the output to 1")
    frames = []
    for number, graph in enumerate(frames_of(context, moving=moving)):
        camera = scene.camera
        place, turn, _ = place_and_turn(camera.name, place_of(camera, root, graph))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, place
        lens = _lens(scene, camera.evaluated_get(graph).data)
        frames.append(
            {
                "file_path": f"frame_{number:03}.png",
                **lens,
                "transform_matrix": pose.tolist(),
            }
        )
    path = bundle.folder / name
    write_json(path, {"camera_model": "OPENCV", "frames": frames})
    return path


def _taken(bundle: Bundle) -> set[str]:
    return {"bundle.json", *bundle.about["files"].values()}


def _lens(scene: bpy.types.Scene, data: bpy.types.Camera) -> dict[str, float]:
    """Width, height, focal lengths and principal point in pixels."""
    share = scene.render.resolution_percentage / 100
    width = int(scene.render.resolution_x * share)
    height = int(scene.render.resolution_y * share)
    wide = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and width >= height)
    side = width if wide else height
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    focal = data.lens / sensor * side
    if not (math.isfinite(focal) and focal > 0):
        raise BridgeError("expected a camera with a focal length above 0")
    return {
        "w": width,
        "h": height,
        "fl_x": focal,
        "fl_y": focal,
        "cx": width / 2 - data.shift_x * side,
        "cy": height / 2 + data.shift_y * side,
    }

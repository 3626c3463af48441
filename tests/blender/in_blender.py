"""Run by Blender's Python: poses a bundle, exports it every way, writes down what Blender shows."""

import json
import os
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "blender"))
import pcore_bridge

BUNDLE = Path(sys.argv[1])
SEEN: dict = {}


def fresh(end: int):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.pcore.import_bundle(filepath=str(BUNDLE / "bundle.json"))
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, end
    roots = [item for item in bpy.data.objects if item.get("pcore_role") == "root"]
    # The user may put the whole anywhere, at any size.
    roots[0].location, roots[0].scale = (3.0, -1.0, 2.0), (2.0, 2.0, 2.0)
    return roots[0]


def shown(name: str, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    item = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = item.to_mesh()
    places = np.array([v.co[:] for v in mesh.vertices])
    item.to_mesh_clear()
    return places


def refused(what: str, operator, **options) -> None:
    try:
        operator(**options)
        SEEN[what] = "not refused"
    except RuntimeError as error:
        SEEN[what] = str(error)


def anchors() -> None:
    fresh(21)
    one, two = bpy.data.objects["anchor 003"], bpy.data.objects["anchor 010"]
    one.keyframe_insert("location", frame=1)
    one.keyframe_insert("rotation_quaternion", frame=1)
    one.location.x += 0.3
    one.rotation_quaternion = (0.8, 0.6, 0.0, 0.0)
    one.keyframe_insert("location", frame=21)
    one.keyframe_insert("rotation_quaternion", frame=21)
    two["pcore_pin"] = True
    bpy.ops.pcore.export_edit(mode="anchors", name="drag.json")
    SEEN["anchors"] = []
    for frame in range(1, 22):
        bpy.context.scene.frame_set(frame)
        SEEN["anchors"].append([*one.matrix_local.translation])
    SEEN["pinned"] = list(two["pcore_near"])
    one.scale = (1.0, 1.0, -1.0)
    refused("negative", bpy.ops.pcore.export_edit, mode="anchors")
    one.scale = (1.0, 1.0, 1.0)
    sheared = bpy.data.objects.new("uneven", None)
    bpy.context.scene.collection.objects.link(sheared)
    sheared.parent, sheared.scale = one.parent, (1.0, 3.0, 1.0)
    one.parent = sheared
    refused("sheared", bpy.ops.pcore.export_edit, mode="anchors")


def waved(name: str) -> None:
    """Bend a mesh over time by a shape key."""
    item = bpy.data.objects[name]
    item.shape_key_add(name="Basis")
    key = item.shape_key_add(name="bent")
    for point in key.data:
        point.co.x += 0.1 * point.co.z * point.co.z
    key.value = 0.0
    key.keyframe_insert("value", frame=1)
    key.value = 1.0
    key.keyframe_insert("value", frame=5)


def shapes() -> None:
    for mode, name in (("points", "points"), ("cage", "cage"), ("mesh", "proxy")):
        fresh(5)
        waved(name)
        bpy.ops.pcore.export_edit(mode=mode, name=f"{mode}.json")
        np.save(BUNDLE / f"seen_{mode}.npy", [shown(name, frame) for frame in (1, 3, 5)])
    fresh(5)
    refused("still", bpy.ops.pcore.export_edit, mode="cage")
    refused("own file", bpy.ops.pcore.export_edit, mode="cage", name="cameras.json")
    bpy.data.objects["cage"].modifiers.new("finer", "SUBSURF")
    refused("topology", bpy.ops.pcore.export_edit, mode="cage")
    bpy.data.objects["points"].data.vertices[0].co.x += 0.01
    refused("edited", bpy.ops.pcore.export_edit, mode="points")
    refused("program", bpy.ops.pcore.render, program="/no/such/program", edit="cage.json")


def cameras() -> None:
    fresh(3)
    scene = bpy.context.scene
    content = json.loads((BUNDLE / "cameras.json").read_text())
    scene.render.resolution_x, scene.render.resolution_y = content["w"], content["h"]
    bpy.ops.pcore.export_cameras(name="path.json", moving=False)


try:
    pcore_bridge.register()
    anchors()
    shapes()
    cameras()
    (BUNDLE / "seen.json").write_text(json.dumps(SEEN))
    sys.stdout.write("done\n")
    sys.stdout.flush()
    code = 0
except Exception:
    traceback.print_exc()
    code = 1
# Blender as a module may hang while Python shuts down.
sys.stderr.flush()
os._exit(code)

"""Run by Blender's Python: poses a bundle, exports it every way, writes down what Blender shows."""

import json
import os
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

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
    bpy.context.view_layer.update()
    return roots[0]


def shown(name: str, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    item = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = item.to_mesh()
    places = np.array([v.co[:] for v in mesh.vertices])
    item.to_mesh_clear()
    return places


def refused(what: str, operator, /, **options) -> None:
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
    root = next(item for item in bpy.data.objects if item.get("pcore_role") == "root")
    SEEN["up"] = [*(root.matrix_world.to_3x3() @ Vector((0.0, -1.0, 0.0))).normalized()]
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


def rigs() -> None:
    root = fresh(1)
    scene = bpy.context.scene
    near = np.array(bpy.data.objects["anchor 005"]["pcore_near"])
    scene.cursor.location = root.matrix_world @ Vector(3 * near)
    refused("far", bpy.ops.pcore.add_handle)
    scene.cursor.location = root.matrix_world @ Vector(1.02 * near)
    refused("taken", bpy.ops.pcore.add_handle)
    bpy.ops.pcore.pin()
    SEEN["held"] = [item.name for item in bpy.data.objects if item.get("pcore_pin")]
    points = np.array([v.co[:] for v in bpy.data.objects["points"].data.vertices])
    anchors = [item["pcore_near"] for item in bpy.data.objects if item.get("pcore_near")]
    free = points[[np.abs(np.array(anchors) - one).max(axis=1).min() > 0.05 for one in points]][0]
    scene.cursor.location = root.matrix_world @ Vector(free)
    bpy.ops.pcore.add_handle()
    handle = bpy.context.view_layer.objects.active
    handle.location.z += 0.2
    bpy.ops.pcore.export_edit(mode="anchors", name="handle.json", moving=False)
    SEEN["handle"] = [[float(x) for x in free], [*handle.location]]
    refused("cage there", bpy.ops.pcore.add_cage)
    bpy.data.objects.remove(bpy.data.objects["cage"])
    bpy.ops.pcore.add_cage()
    bpy.ops.pcore.add_lattice(what="cage", resolution=2)
    refused("lattice there", bpy.ops.pcore.add_lattice, what="cage")
    lattice = bpy.context.view_layer.objects.active
    for corner in lattice.data.points:
        corner.co_deform.x += 0.1 * corner.co.z
    bpy.ops.pcore.export_edit(mode="cage", name="lattice.json", moving=False)
    np.save(BUNDLE / "seen_lattice.npy", shown("cage", 1))


def bones() -> None:
    root = fresh(1)
    refused("no anchors", bpy.ops.pcore.bind_armature)
    anchors = [item for item in bpy.data.objects if item.get("pcore_role") == "anchor"]
    low, high = (pick(anchors, key=lambda item: item.location.z) for pick in (min, max))
    root.select_set(False)
    low.select_set(True)
    high.select_set(True)
    bpy.context.view_layer.objects.active = low
    bpy.ops.pcore.bind_armature()
    armature = bpy.context.view_layer.objects.active
    SEEN["bones"] = [bone.name for bone in armature.data.bones]
    SEEN["rest"] = float(np.abs(shown("proxy", 1) - proxy_rest()).max())
    bend = armature.pose.bones[low.name]
    bend.rotation_mode = "QUATERNION"
    bend.rotation_quaternion = (0.98, 0.2, 0.0, 0.0)
    bpy.context.view_layer.update()
    bpy.ops.pcore.export_edit(mode="anchors", name="bones.json", moving=False)
    local = root.matrix_world.inverted() @ high.matrix_world
    SEEN["carried"] = [[*high["pcore_near"]], [*local.translation]]
    bpy.ops.pcore.export_edit(mode="mesh", name="bent.json", moving=False)
    SEEN["moved"] = float(np.abs(shown("proxy", 1) - proxy_rest()).max())


def proxy_rest() -> np.ndarray:
    return np.array([v.co[:] for v in bpy.data.objects["proxy"].data.vertices])


def pictures() -> None:
    fresh(3)
    scene = bpy.context.scene
    folder = BUNDLE / "rendered"
    folder.mkdir()
    refused("no frames", bpy.ops.pcore.import_frames, directory=str(folder))
    content = json.loads((BUNDLE / "cameras.json").read_text())
    scene.render.resolution_x, scene.render.resolution_y = content["w"], content["h"]
    for number in range(3):
        image = bpy.data.images.new("frame", content["w"], content["h"], alpha=True)
        one = np.float32([0.2 * number, 0.5, 0.1, 1.0])
        image.pixels.foreach_set(np.tile(one, content["w"] * content["h"]))
        image.filepath_raw, image.file_format = str(folder / f"frame_{number:03}.png"), "PNG"
        image.save()
    for where in ("behind", "plane", "compositor"):
        bpy.ops.pcore.import_frames(directory=str(folder), where=where)
    plane = bpy.data.objects["pcore picture"]
    bpy.context.view_layer.update()
    seen = [
        world_to_camera_view(scene, scene.camera, plane.matrix_world @ vertex.co)[:2]
        for vertex in plane.data.vertices
    ]
    SEEN["corners"] = [list(corner) for corner in seen]
    image = next(n for n in plane.active_material.node_tree.nodes if n.type == "TEX_IMAGE")
    SEEN["sequence"] = [image.image_user.frame_duration, image.image.source, image.image.alpha_mode]
    tree = getattr(scene, "compositing_node_group", None) or scene.node_tree
    over = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeAlphaOver")
    linked = [s.links[0].from_node.bl_idname for s in over.inputs if s.is_linked]
    SEEN["composited"] = [linked, bool(over.outputs[0].links), scene.render.film_transparent]
    (folder / "frame_001.png").unlink()
    refused("gap", bpy.ops.pcore.import_frames, directory=str(folder))


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
    rigs()
    bones()
    pictures()
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

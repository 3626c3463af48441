"""Run by a Python that has Blender: FOLDER gets models with rigs, and where Blender moves them.

INTERPOLATION.glb and INTERPOLATION.npz, vertices in world space by frame: two skins, one of a
mirrored rig and one with a morph target besides, a mesh that several nodes share, one of them
mirrored and others scaled unevenly, curves of the named interpolation.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

FRAMES = (1, 5.5, 10, 13, 20, 27, 30)
TURNS = ((1, 0.0), (10, 1.0), (20, -1.0), (30, 0.3))


def curves(action: Any) -> list[Any]:
    if hasattr(action, "fcurves"):
        return [*action.fcurves]
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags for curve in bag.fcurves]


def interpolate(owner: Any, kind: str) -> None:
    for curve in curves(owner.animation_data.action):
        for key in curve.keyframe_points:
            key.interpolation = kind


def tube() -> Any:
    bpy.ops.mesh.primitive_cylinder_add(vertices=16, radius=0.3, depth=2)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.object.mode_set(mode="OBJECT")
    return bpy.context.object


def rigged(place: tuple[float, float, float], scale: tuple[float, float, float]) -> Any:
    """A tube that two bones bend, and their armature."""
    body = tube()
    bones = bpy.data.armatures.new("rig")
    rig = bpy.data.objects.new("rig", bones)
    bpy.context.collection.objects.link(rig)
    rig.location, rig.scale = place, scale
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    low, high = bones.edit_bones.new("low"), bones.edit_bones.new("high")
    low.head, low.tail = high.head, high.tail = (0, 0, -1), (0, 0, 0)
    high.head, high.tail, high.parent = (0, 0, 0), (0, 0, 1), low
    bpy.ops.object.mode_set(mode="OBJECT")
    body.parent = rig
    body.modifiers.new("rig", "ARMATURE").object = rig
    groups = [body.vertex_groups.new(name=name) for name in ("low", "high")]
    for vertex in body.data.vertices:
        share = min(1.0, max(0.0, vertex.co.z + 0.5))
        for group, weight in zip(groups, (1 - share, share), strict=True):
            group.add([vertex.index], weight, "REPLACE")
    return body, rig


def turn(rig: Any, amount: float, kind: str) -> None:
    bone = rig.pose.bones["high"]
    bone.rotation_mode = "QUATERNION"
    for frame, angle in TURNS:
        bone.rotation_quaternion = Matrix.Rotation(amount * angle, 3, "X").to_quaternion()
        bone.location = (0.1 * angle, 0, 0.005 * frame)
        bone.keyframe_insert("rotation_quaternion", frame=frame)
        bone.keyframe_insert("location", frame=frame)
    interpolate(rig, kind)


def swell(body: Any, kind: str) -> None:
    body.shape_key_add(name="Basis")
    key = body.shape_key_add(name="fat")
    for vertex in body.data.vertices:
        if vertex.co.z > 0.2:
            key.data[vertex.index].co = vertex.co + Vector((0.6 * vertex.co.x, 0, 0))
    for frame, value in ((1, 0.0), (15, 1.0), (30, 0.2)):
        key.value = value
        key.keyframe_insert("value", frame=frame)
    interpolate(body.data.shape_keys, kind)


def shared() -> None:
    bpy.ops.mesh.primitive_monkey_add(location=(0, -1.5, 0))
    head = bpy.context.object.data
    for place, scale in (((0, 1.8, 0.5), (-0.5, 0.5, 0.5)), ((1, -1, 1), (0.3, 0.3, 0.6))):
        other = bpy.data.objects.new("other", head)
        other.location, other.scale, other.rotation_euler = place, scale, (0.3, 0.4, 0.2)
        bpy.context.collection.objects.link(other)


def vertices(frame: float) -> np.ndarray:
    bpy.context.scene.frame_set(int(frame), subframe=frame - int(frame))
    found: list[np.ndarray] = []
    for one in bpy.context.evaluated_depsgraph_get().object_instances:
        if one.object.type == "MESH":
            place = np.array(one.matrix_world)
            mesh = one.object.to_mesh()
            local = np.array([vertex.co[:] for vertex in mesh.vertices])
            found.append(local @ place[:3, :3].T + place[:3, 3])
            one.object.to_mesh_clear()
    return np.concatenate(found)


def write(folder: Path, kind: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    body, rig = rigged((-1, 0, 0.2), (1.3, 1.3, 1.3))
    turn(rig, 1.0, kind)
    swell(body, kind)
    _, mirrored = rigged((1, 0.5, 0), (-0.8, 0.8, 0.8))
    turn(mirrored, -0.7, kind)
    shared()
    bpy.ops.export_scene.gltf(
        filepath=str(folder / f"{kind}.glb"),
        export_animation_mode="ACTIVE_ACTIONS",
        export_force_sampling=False,
        export_optimize_animation_size=False,
    )
    np.savez(folder / f"{kind}.npz", **{str(frame): vertices(frame) for frame in FRAMES})


for each in ("BEZIER", "CONSTANT", "LINEAR"):
    write(Path(sys.argv[1]), each)

"""Pictures that pcore rendered, back in the scene: behind the camera, on a plane, composited."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from .bundle import BridgeError
from .scene import root_of

BEHIND, PLANE, COMPOSITOR = "behind", "plane", "compositor"
_SHAPE = 0.01
"""By how much a picture's ratio of sides may differ from the scene's."""


def import_frames(
    context: bpy.types.Context, folder: Path, where: str = BEHIND
) -> tuple[bpy.types.Image, list[str]]:
    """Show pictures frame_NNN.png with what the scene's camera sees, one for every frame.

    Args:
        context: of Blender.
        folder: of the pictures.
        where: `BEHIND` what the camera sees, in the viewport; on a `PLANE` before the camera, at
            the distance of the object, which renders; or under the render, in the `COMPOSITOR`.

    Returns:
        The sequence, and what the user should know.

    Raises:
        BridgeError: no such pictures, some are missing, or no camera that can show them.
    """
    numbers = _numbers(folder)
    camera = context.scene.camera
    if camera is None:
        raise BridgeError("expected an active camera in the scene to show the pictures with")
    if where == PLANE and camera.data.type != "PERSP":
        raise BridgeError(f"{camera.name}: expected a camera of type Perspective for a plane")
    first = min(numbers)
    image = bpy.data.images.load(str(numbers[first]), check_existing=False)
    image.source, image.alpha_mode = "SEQUENCE", "STRAIGHT"
    notes = _notes(context.scene, image)
    timing = {
        "frame_duration": len(numbers),
        "frame_start": context.scene.frame_start,
        "frame_offset": first - 1,
    }
    if where == BEHIND:
        user = _behind(camera.data, image)
    elif where == PLANE:
        user = _plane(context, camera, image)
    else:
        user = _composited(context.scene, image)
    for name, value in timing.items():
        setattr(user, name, value)
    return image, notes


def _numbers(folder: Path) -> dict[int, Path]:
    """Pictures by their numbers, without a gap."""
    numbers = {_number(path): path for path in folder.glob("frame_*.png")}
    numbers.pop(None, None)
    if not numbers:
        raise BridgeError(f"{folder}: expected pictures frame_000.png, ..., got none")
    first, last = min(numbers), max(numbers)
    missing = [number for number in range(first, last + 1) if number not in numbers]
    if missing:
        raise BridgeError(
            f"{folder}: expected a picture for every frame, got none for {len(missing)} of them, "
            f"the first is frame_{missing[0]:03}.png; render them again"
        )
    return numbers


def _number(path: Path) -> int | None:
    digits = path.stem.removeprefix("frame_")
    return int(digits) if digits.isdecimal() else None


def _notes(scene: bpy.types.Scene, image: bpy.types.Image) -> list[str]:
    width, height = image.size
    wide, high = scene.render.resolution_x, scene.render.resolution_y
    if not height or abs(width / height * high / wide - 1) <= _SHAPE:
        return []
    return [
        f"the pictures are {width} x {height}, the scene renders {wide} x {high}: give the output "
        "the same shape, or they will not lie over what the camera sees"
    ]


def _behind(data: bpy.types.Camera, image: bpy.types.Image):
    data.show_background_images = True
    behind = data.background_images.new()
    behind.image, behind.alpha = image, 1.0
    return behind.image_user


def _plane(context: bpy.types.Context, camera: bpy.types.Object, image: bpy.types.Image):
    """A plane that fills what the camera sees, as far away as the object."""
    root = root_of(context)
    away = camera.matrix_world.inverted() @ root.matrix_world.translation
    depth = -away.z
    if not depth > 0:
        raise BridgeError(f"{camera.name}: the object is behind it; turn it round first")
    corners = np.array([corner[:] for corner in camera.data.view_frame(scene=context.scene)])
    corners *= depth / -corners[:, 2:]
    mesh = bpy.data.meshes.new("pcore picture")
    # Counter-clockwise from the upper right corner, as Blender gives them, turned to the camera.
    mesh.from_pydata(corners.tolist(), [], [(0, 3, 2, 1)])
    layer = mesh.uv_layers.new(name="UVMap")
    places = {0: (1.0, 1.0), 1: (1.0, 0.0), 2: (0.0, 0.0), 3: (0.0, 1.0)}
    for loop, entry in zip(mesh.loops, layer.data, strict=True):
        entry.uv = places[loop.vertex_index]
    plane = bpy.data.objects.new("pcore picture", mesh)
    plane.parent = camera
    context.scene.collection.objects.link(plane)
    material, user = _shining(image)
    mesh.materials.append(material)
    return user


def _shining(image: bpy.types.Image):
    """A material with the colours of a sequence as they are, and its opacity."""
    material = bpy.data.materials.new("pcore picture")
    material.use_nodes = True
    material.surface_render_method = "BLENDED"
    tree = material.node_tree
    tree.nodes.clear()
    picture, light, clear, mix, output = (
        tree.nodes.new(f"ShaderNode{kind}")
        for kind in ("TexImage", "Emission", "BsdfTransparent", "MixShader", "OutputMaterial")
    )
    picture.image, picture.extension = image, "CLIP"
    picture.image_user.use_auto_refresh = True
    tree.links.new(picture.outputs["Color"], light.inputs["Color"])
    tree.links.new(picture.outputs["Alpha"], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(light.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    return material, picture.image_user


def _composited(scene: bpy.types.Scene, image: bpy.types.Image):
    """The render over the pictures; whatever the compositor did before is left beside it."""
    scene.render.film_transparent = True
    group = hasattr(scene, "compositing_node_group")  # Blender 5.0 and later
    if group:
        tree = scene.compositing_node_group or bpy.data.node_groups.new(
            "pcore pictures", "CompositorNodeTree"
        )
        scene.compositing_node_group = tree
    else:
        scene.use_nodes = True
        tree = scene.node_tree
    rendered = _node(tree, "CompositorNodeRLayers")
    picture = tree.nodes.new("CompositorNodeImage")
    picture.image = image
    over = tree.nodes.new("CompositorNodeAlphaOver")
    pictures = [socket for socket in over.inputs if socket.type == "RGBA"]
    tree.links.new(picture.outputs["Image"], pictures[0])
    tree.links.new(rendered.outputs["Image"], pictures[1])
    if group:
        if not any(item.in_out == "OUTPUT" for item in tree.interface.items_tree):
            tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        end = _node(tree, "NodeGroupOutput")
    else:
        end = _node(tree, "CompositorNodeComposite")
    tree.links.new(over.outputs["Image"], end.inputs[0])
    return picture


def _node(tree, kind: str):
    """The node of a kind that there is, or a new one."""
    known = [node for node in tree.nodes if node.bl_idname == kind]
    return known[0] if known else tree.nodes.new(kind)

"""Runs inside Blender (`python in_blender.py FOLDER`): takes the pictures that a folder asks for.

It has Blender's Python and numpy and nothing else, so that it imports nothing of pcore.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

JOB_FILE, PAINT_FILE = "job.json", "paint.npz"
DONE = "picture done: "
_THRESHOLD = 0.03
"""Noise at which Cycles sends no more paths."""


def take_pictures(folder: Path) -> None:
    """Render all shots of `job.json` as N.png, RGBA with straight alpha, and print each number."""
    import bpy  # pyright: ignore[reportMissingImports]
    from mathutils import Matrix  # pyright: ignore[reportMissingImports]

    job = json.loads((folder / JOB_FILE).read_text(encoding="utf-8"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    _set_up(scene, job)
    _light(bpy, scene, job)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.clip_start, camera.data.clip_end = 0.01, 1000.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    with np.load(folder / PAINT_FILE, allow_pickle=False) as file:
        paint = dict(file)
    materials = [_material(bpy, folder, n, one) for n, one in enumerate(job["materials"])]
    shown: Any = None
    for number, (shape, pose, angle) in enumerate(job["shots"]):
        if shown is None or shown.name != f"shape {shape}":
            if shown is not None:
                bpy.data.meshes.remove(shown.data)
            shown = _object(bpy, folder, shape, paint, materials)
            scene.collection.objects.link(shown)
        camera.data.angle = angle
        camera.matrix_world = Matrix(pose)
        scene.render.filepath = str(folder / f"{number}.png")
        bpy.ops.render.render(write_still=True)
        sys.stdout.write(f"{DONE}{number}\n")
        sys.stdout.flush()


def _set_up(scene: Any, job: dict[str, Any]) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = job["resolution"]
    render.resolution_percentage = 100
    render.film_transparent = True
    render.use_persistent_data = True
    render.dither_intensity = 0.0
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGBA"
    render.image_settings.color_depth = "8"
    scene.view_settings.view_transform = "Standard"
    cycles.device = "CPU"
    cycles.seed = 0
    cycles.samples = job["samples"]
    cycles.adaptive_threshold = _THRESHOLD
    cycles.use_denoising = True
    # A pixel is the mean over its square, as in the embedded renderer.
    cycles.pixel_filter_type = "BOX"


def _light(bpy: Any, scene: Any, job: dict[str, Any]) -> None:
    """A sky that is brighter above, and suns as wide as the lamps."""
    ground, sky = job["sky"]
    world = bpy.data.worlds.new("sky")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    place = nodes.new("ShaderNodeTexCoord")
    split = nodes.new("ShaderNodeSeparateXYZ")
    height = nodes.new("ShaderNodeMath")
    height.operation = "MULTIPLY_ADD"
    # A sky a + b z gives a surface of normal n the light a + 2/3 b n_z.
    height.inputs[1].default_value = 1.5 * 0.5 * (sky - ground)
    height.inputs[2].default_value = 0.5 * (sky + ground)
    links.new(place.outputs["Generated"], split.inputs[0])
    links.new(split.outputs["Z"], height.inputs[0])
    links.new(height.outputs[0], nodes["Background"].inputs["Strength"])
    nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    for number, (x, y, z, strength, radius) in enumerate(job["lamps"]):
        lamp = bpy.data.lights.new(f"lamp {number}", "SUN")
        lamp.energy = math.pi * strength
        # A disc whose variance is that of the embedded renderer's lamp.
        lamp.angle = 2.0 * math.atan(2.0 * radius)
        one = bpy.data.objects.new(lamp.name, lamp)
        one.rotation_euler = (math.acos(z / math.hypot(x, y, z)), 0.0, math.atan2(x, -y))
        scene.collection.objects.link(one)


def _material(bpy: Any, folder: Path, number: int, about: dict[str, Any]) -> Any:
    """Diffuse: factor x texture x colours of vertices; cut out where alpha is below the cutoff."""
    material = bpy.data.materials.new(f"material {number}")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    output, diffuse = nodes.new("ShaderNodeOutputMaterial"), nodes.new("ShaderNodeBsdfDiffuse")
    vertex = nodes.new("ShaderNodeAttribute")
    vertex.attribute_name = "colors"
    factor = nodes.new("ShaderNodeRGB")
    factor.outputs[0].default_value = (*about["color"][:3], 1.0)
    colors, alphas = [vertex.outputs["Color"], factor.outputs[0]], [vertex.outputs["Alpha"]]
    if about["texture"]:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(str(folder / f"texture_{number}.png"))
        picture.image.alpha_mode = "CHANNEL_PACKED"
        picture.extension = about["extension"]
        colors.append(picture.outputs["Color"])
        alphas.append(picture.outputs["Alpha"])
    links.new(_product(nodes, links, "ShaderNodeVectorMath", colors), diffuse.inputs["Color"])
    surface = diffuse.outputs[0]
    if about["cutoff"] > 0:
        solid = nodes.new("ShaderNodeMath")
        solid.operation = "GREATER_THAN"
        links.new(_product(nodes, links, "ShaderNodeMath", alphas), solid.inputs[0])
        solid.inputs[1].default_value = about["cutoff"] / max(about["color"][3], 1e-6) - 1e-6
        mixed, clear = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeBsdfTransparent")
        links.new(solid.outputs[0], mixed.inputs[0])
        links.new(clear.outputs[0], mixed.inputs[1])
        links.new(surface, mixed.inputs[2])
        surface = mixed.outputs[0]
    links.new(surface, output.inputs["Surface"])
    return material


def _product(nodes: Any, links: Any, kind: str, factors: list[Any]) -> Any:
    found = factors[0]
    for other in factors[1:]:
        node = nodes.new(kind)
        node.operation = "MULTIPLY"
        links.new(found, node.inputs[0])
        links.new(other, node.inputs[1])
        found = node.outputs[0]
    return found


def _object(
    bpy: Any, folder: Path, number: int, paint: dict[str, Any], materials: list[Any]
) -> Any:
    with np.load(folder / f"shape_{number}.npz", allow_pickle=False) as file:
        vertices, corners = file["vertices"], file["corners"]
    mesh = bpy.data.meshes.new(f"shape {number}")
    mesh.from_pydata(vertices.tolist(), [], paint["faces"].tolist())
    for one in materials:
        mesh.materials.append(one)
    mesh.polygons.foreach_set("material_index", paint["material"].astype(np.int32))
    layer = mesh.uv_layers.new(name="uv")
    layer.uv.foreach_set("vector", paint["uv"].astype(np.float32).ravel())
    colors = mesh.color_attributes.new("colors", "FLOAT_COLOR", "POINT")
    values = paint.get("colors", np.ones((len(vertices), 4)))
    colors.data.foreach_set("color", values.astype(np.float32).ravel())
    mesh.normals_split_custom_set(corners.reshape(-1, 3).tolist())
    mesh.update()
    return bpy.data.objects.new(mesh.name, mesh)


if __name__ == "__main__":
    take_pictures(Path(sys.argv[1]))

"""Objects of our own with true pictures of deformed states, rendered by Blender in three lights.

    BLENDER benchmarks/lit_scenes.py mesh OUT                        # the monkey's mesh
    python  benchmarks/lit_scenes.py pose OUT --cameras SCENE        # states, cameras, colours
    BLENDER benchmarks/lit_scenes.py shoot OUT                       # pictures, some minutes

BLENDER is the Python of an environment with `pip install bpy==4.5.4 numpy`; the other one is of
pcore. Cameras are those of SCENE (spot of the test data here). Makes OUT/figure, OUT/suzanne,
OUT/speckled, in the layout of evaluation sets, for choices that must not be made on the benchmark's
own states: a figure with limbs in soft light of several lamps, Blender's monkey in hard light of
one, and the figure again, in other poses, with speckled paint among lamps so near that they light
its sides differently. `--only NAME` shoots one of them.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OBJECTS = ("figure", "suzanne", "speckled")
LIGHTS: dict[str, tuple[float, list[tuple[str, float, tuple[float, float, float], float]]]] = {
    "figure": (0.45, [("SUN", 2.2, (2, -1.5, 2.5), 0.3), ("AREA", 90, (-3, 1, 1), 2.0)]),
    "suzanne": (0.25, [("SUN", 3.2, (-1.5, -2, 2), 0.3)]),
    "speckled": (0.15, [("AREA", 130, (1.8, -2.2, 2.2), 1.0), ("AREA", 30, (-3, -1, 1), 2.5)]),
}
"""Strength of the sky, and lamps: kind, energy, place, size (angle of suns)."""
_BONES: tuple[tuple[tuple[float, float, float], tuple[float, float, float], float], ...] = (
    ((0, 0, -0.15), (0, 0, 0.3), 0.17),  # Torso.
    ((0, 0, 0.52), (0, 0, 0.56), 0.14),
    ((0, -0.12, 0.52), (0, -0.2, 0.5), 0.04),  # Nose.
    ((0.12, 0, 0.3), (0.62, 0, 0.3), 0.075),  # Arms.
    ((-0.12, 0, 0.3), (-0.62, 0, 0.3), 0.075),
    ((0.12, 0, -0.2), (0.16, 0, -0.8), 0.09),  # Legs and feet.
    ((-0.12, 0, -0.2), (-0.16, 0, -0.8), 0.09),
    ((0.16, 0, -0.8), (0.16, -0.18, -0.82), 0.07),
    ((-0.16, 0, -0.8), (-0.16, -0.18, -0.82), 0.07),
)
_GRID, _BLEND = 192, 30.0


def main() -> None:
    """Do the step that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("step", choices=("mesh", "pose", "shoot"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--cameras", type=Path)
    parser.add_argument("--only", choices=OBJECTS, help="the object to shoot")
    wish = parser.parse_args()
    wish.out.mkdir(parents=True, exist_ok=True)
    if wish.step == "mesh":
        save_monkey(wish.out / "suzanne.npz")
    elif wish.step == "pose":
        make_figure(wish.out / "figure", wish.cameras)
        make_suzanne(wish.out / "suzanne", wish.out / "suzanne.npz", wish.cameras)
        make_speckled(wish.out / "speckled", wish.cameras)
    else:
        for name in [wish.only] if wish.only else OBJECTS:
            shoot(wish.out / name, LIGHTS[name])


def save_monkey(path: Path) -> None:
    """Write Blender's monkey, subdivided three times."""
    import bpy  # pyright: ignore[reportMissingImports]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_monkey_add(size=1.6)
    monkey = bpy.context.object
    monkey.modifiers.new("smooth", "SUBSURF").levels = 3
    mesh = monkey.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    mesh.calc_loop_triangles()
    np.savez(
        path,
        vertices=np.array([vertex.co for vertex in mesh.vertices]),
        faces=np.array([triangle.vertices for triangle in mesh.loop_triangles]),
    )


def make_suzanne(out: Path, mesh: Path, cameras: Path) -> None:
    """The monkey: four paints, three formulas."""
    with np.load(mesh) as file:
        vertices, faces = file["vertices"], file["faces"]
    scale, center = _size(vertices)
    vertices = (vertices - center) * scale
    x, y, z = vertices.T
    color = np.full(vertices.shape, (0.45, 0.28, 0.18))
    color[(y < -0.25) & (z < 0.1)] = 0.75, 0.6, 0.45
    color[np.abs(x) > 0.75] = 0.7, 0.3, 0.3
    color[(np.sin(25 * x) * np.sin(25 * z) > 0.4) & (y > -0.2)] = 0.2, 0.45, 0.3
    records = {
        "twist70y": _record("TWIST", "Y", 1.2, vertices),
        "bend60x": _record("BEND", "X", 1.05, vertices),
        "stretchz": _record("STRETCH", "Z", 0.4, vertices),
    }
    _write(out, cameras, vertices, faces, color, records, {})


def make_figure(out: Path, cameras: Path) -> None:
    """A figure of rounded limbs: seven paints, three formulas and two poses."""
    limbs, faces = figure_mesh()
    color = clothes(limbs)
    vertices, poses = _posed(limbs, cheerful=_cheerful, stroll=_stroll)
    records = {
        "twist80z": _record("TWIST", "Z", 1.4, vertices),
        "bend50x": _record("BEND", "X", 0.87, vertices),
        "taperz": _record("TAPER", "Z", 0.5, vertices),
    }
    _write(out, cameras, vertices, faces, color, records, poses)


def make_speckled(out: Path, cameras: Path) -> None:
    """The figure in other poses, its paint speckled at three sizes: two formulas, two poses."""
    limbs, faces = figure_mesh()
    random = np.random.default_rng(1)
    speckles = np.zeros(len(limbs))
    for size in (9.0, 20.0, 45.0):
        waves = random.normal(size=(24, 3)) * size
        phases = random.uniform(0, 2 * np.pi, 24)
        speckles += np.cos(limbs @ waves.T + phases).mean(axis=1) * np.sqrt(2 * 24)
    color = np.clip(clothes(limbs) * np.exp(0.2 * speckles)[:, None], 0.02, 0.95)
    vertices, poses = _posed(limbs, crouch=_crouch, salute=_salute)
    records = {
        "twist60x": _record("TWIST", "X", 1.05, vertices),
        "bend45y": _record("BEND", "Y", 0.8, vertices),
        "grow16": {"type": "scale", "factor": 1.6},
    }
    _write(out, cameras, vertices, faces, color, records, poses)


def _posed(limbs: Array, **poses: Callable[[Array], Array]) -> tuple[Array, dict[str, Array]]:
    """The figure at rest and in poses, sized as it is at rest."""
    scale, center = _size(limbs)
    moved = {name: (pose(limbs) - center) * scale for name, pose in poses.items()}
    return (limbs - center) * scale, moved


def clothes(vertices: Array) -> Array:
    """Seven paints (V, 3), linear."""
    x, _, z = vertices.T
    color = np.full(vertices.shape, (0.75, 0.55, 0.4))
    shirt = (z < 0.28) & (z > -0.25) & (np.abs(x) < 0.3)
    color[shirt] = 0.2, 0.35, 0.7
    color[z < -0.25] = 0.3, 0.3, 0.32
    color[z < -0.72] = 0.6, 0.2, 0.12
    color[(np.sin(40 * z) > 0.3) & shirt] = 0.8, 0.75, 0.3
    color[z > 0.58] = 0.35, 0.2, 0.1
    color[(np.abs(x) > 0.45) & (z > 0.2)] = 0.8, 0.2, 0.2
    return color


def figure_mesh() -> tuple[Array, NDArray[np.int64]]:
    """Capsules around the bones, blended, as a mesh."""
    from skimage import measure

    steps = np.linspace(-1, 1, _GRID)
    places = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.zeros(len(places))
    for start, end, radius in _BONES:
        a, bone = np.array(start), np.subtract(end, start)
        along = np.clip((places - a) @ bone / (bone @ bone), 0, 1)
        distance = np.linalg.norm(places - a - along[:, None] * bone, axis=1)
        inside += np.exp(_BLEND * (radius - distance))
    field = -np.log(inside).reshape(_GRID, _GRID, _GRID)
    vertices, faces, *_ = measure.marching_cubes(field, 0.0)
    return 2 * vertices / (_GRID - 1) - 1, faces[:, ::-1].astype(np.int64)


def _cheerful(vertices: Array) -> Array:
    x, _, z = vertices.T
    arm, hip = z > 0.1, _ramp(-z, 0.18, 0.32)
    left, right = _ramp(x, 0.14, 0.24) * arm, _ramp(-x, 0.14, 0.24) * arm
    moved = _turned(vertices, left, (0.17, 0, 0.3), -1.1, 1)
    moved = _turned(moved, right, (-0.17, 0, 0.3), 0.6, 1)
    return _turned(moved, hip * (x > 0), (0.13, 0, -0.22), -0.9, 0)


def _stroll(vertices: Array) -> Array:
    x, _, z = vertices.T
    arm, hip = z > 0.1, _ramp(-z, 0.18, 0.32)
    left, right = _ramp(x, 0.14, 0.24) * arm, _ramp(-x, 0.14, 0.24) * arm
    moved = _turned(vertices, left, (0.17, 0, 0.3), 1.2, 1)
    moved = _turned(moved, right, (-0.17, 0, 0.3), 1.2, 2)
    moved = _turned(moved, hip * (x > 0), (0.13, 0, -0.22), -0.6, 0)
    return _turned(moved, hip * (x < 0), (-0.13, 0, -0.22), 0.7, 0)


def _crouch(vertices: Array) -> Array:
    x, _, z = vertices.T
    arm, hip = z > 0.1, _ramp(-z, 0.18, 0.32)
    left, right = _ramp(x, 0.14, 0.24) * arm, _ramp(-x, 0.14, 0.24) * arm
    moved = _turned(vertices, hip, (0, 0, -0.22), -1.2, 0)
    moved = _turned(moved, left, (0.17, 0, 0.3), -0.9, 2)
    return _turned(moved, right, (-0.17, 0, 0.3), 0.9, 2)


def _salute(vertices: Array) -> Array:
    x, _, z = vertices.T
    arm, hip = z > 0.1, _ramp(-z, 0.18, 0.32)
    left, right = _ramp(x, 0.14, 0.24) * arm, _ramp(-x, 0.14, 0.24) * arm
    moved = _turned(vertices, left, (0.17, 0, 0.3), -0.8, 1)
    moved = _turned(moved, right, (-0.17, 0, 0.3), -1.0, 1)
    moved = _turned(moved, _ramp(z, 0.36, 0.46) * (np.abs(x) < 0.2), (0, 0, 0.4), 0.7, 2)
    return _turned(moved, hip * (x < 0), (-0.13, 0, -0.22), -0.8, 0)


def _ramp(values: Array, low: float, high: float) -> Array:
    share = np.clip((values - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)


def _turned(
    vertices: Array, weight: Array, pivot: tuple[float, float, float], angle: float, axis: int
) -> Array:
    """Turn every vertex about an axis through a pivot by its share of an angle in radians."""
    cos, sin = np.cos(angle * weight), np.sin(angle * weight)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    offset, moved = vertices - pivot, vertices.copy()
    moved[:, first] = pivot[first] + cos * offset[:, first] - sin * offset[:, second]
    moved[:, second] = pivot[second] + sin * offset[:, first] + cos * offset[:, second]
    return moved


def _size(vertices: Array) -> tuple[float, Array]:
    """Factor and centre that give the object a radius of 1 about the origin."""
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return 1 / float(np.linalg.norm(vertices - center, axis=1).max()), center


def _record(method: str, axis: str, value: float, vertices: Array) -> dict[str, Any]:
    driver = {"X": 1, "Y": 0, "Z": 0}[axis] if method == "BEND" else "XYZ".index(axis)
    reach = vertices[:, driver]
    return {
        "type": "simple_deform",
        "method": method,
        "axis": axis,
        "value": value,
        "driver_lo": float(reach.min()),
        "driver_hi": float(reach.max()),
    }


def _write(
    out: Path,
    cameras: Path,
    vertices: Array,
    faces: NDArray[np.int64],
    color: Array,
    records: dict[str, dict[str, Any]],
    poses: dict[str, Array],
) -> None:
    """Write all of a scene but its pictures."""
    import torch

    from pcore.evaluation.deformation_record import DeformationRecord

    out.mkdir(exist_ok=True)
    meshes = {"canonical": vertices, **poses}
    for name, record in records.items():
        formula: Callable[[Any], Any] | None = DeformationRecord.model_validate(
            record
        ).deformation()
        assert formula is not None
        meshes[name] = formula(torch.from_numpy(vertices)).numpy()
    for name in (*records, *poses):
        (out / name).mkdir(exist_ok=True)
        record = records.get(name, {"type": "animation"})
        (out / name / "deformation.json").write_text(json.dumps(record), encoding="utf-8")
        wish = json.loads((cameras / "transforms_test.json").read_text(encoding="utf-8"))
        half = np.tan(wish["camera_angle_x"] / 2) * record.get("factor", 1.0)
        wish["camera_angle_x"] = 2 * float(np.arctan(half))
        (out / name / "transforms_test.json").write_text(json.dumps(wish), encoding="utf-8")
    for split in ("train", "test"):
        shutil.copy(cameras / f"transforms_{split}.json", out)
    single = {name: mesh.astype(np.float32) for name, mesh in meshes.items()}
    np.savez(out / "meshes.npz", faces=faces.astype(np.int32), **single)
    np.savez(out.parent / f"{out.name}_colors.npz", colors=color)


def shoot(
    out: Path, light: tuple[float, list[tuple[str, float, tuple[float, float, float], float]]]
) -> None:
    """Render all views of all states at 100 x 100 pixels with Cycles."""
    import bpy  # pyright: ignore[reportMissingImports]
    import mathutils  # pyright: ignore[reportMissingImports]

    with np.load(out / "meshes.npz") as file:
        meshes = {name: file[name] for name in file.files}
    with np.load(out.parent / f"{out.name}_colors.npz") as file:
        colors = file["colors"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 48, True
    scene.render.film_transparent, scene.render.use_persistent_data = True, True
    scene.render.resolution_x = scene.render.resolution_y = 100
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.color_mode = "RGBA"
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    sky = scene.world.node_tree.nodes["Background"].inputs
    sky[0].default_value, sky[1].default_value = (0.8, 0.9, 1.0, 1.0), light[0]

    def lamp(kind: str, energy: float, place: tuple[float, float, float], size: float) -> None:
        light = bpy.data.lights.new(kind, kind)
        light.energy = energy
        setattr(light, "angle" if kind == "SUN" else "size", size)
        thing = bpy.data.objects.new(kind, light)
        thing.location = place
        thing.rotation_euler = mathutils.Vector(place).to_track_quat("Z", "Y").to_euler()
        scene.collection.objects.link(thing)

    for one in light[1]:
        lamp(*one)
    mesh = bpy.data.meshes.new("object")
    mesh.from_pydata(meshes["canonical"].tolist(), [], meshes["faces"].tolist())
    paint = np.c_[colors, np.ones(len(colors))].astype(np.float32)
    attribute = mesh.color_attributes.new("paint", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", paint.ravel())
    for polygon in mesh.polygons:
        polygon.use_smooth = True
    material = bpy.data.materials.new("paint")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes["Principled BSDF"].inputs["Roughness"].default_value = 0.6
    source = nodes.new("ShaderNodeAttribute")
    source.attribute_name = "paint"
    links.new(source.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    mesh.materials.append(material)
    scene.collection.objects.link(bpy.data.objects.new("object", mesh))
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    scene.camera = eye
    jobs = [("canonical", out, split) for split in ("train", "test")]
    jobs += [(n, out / n, "test") for n in meshes if n not in ("canonical", "faces")]
    for name, folder, split in jobs:
        mesh.vertices.foreach_set("co", meshes[name].astype(np.float32).ravel())
        mesh.update()
        wish = json.loads((folder / f"transforms_{split}.json").read_text(encoding="utf-8"))
        eye.data.angle = wish["camera_angle_x"]
        for frame in wish["frames"]:
            eye.matrix_world = mathutils.Matrix(frame["transform_matrix"])
            path = frame["file_path"].removeprefix("./")
            scene.render.filepath = str(folder / f"{path}.png")
            bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()

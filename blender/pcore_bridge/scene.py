"""Objects of a bundle in a scene: making them, finding them, reading where they are."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .bundle import BridgeError, Bundle, Mesh, open_bundle

ROLE, FOLDER, NEAR, PIN = "pcore_role", "pcore_bundle", "pcore_near", "pcore_pin"
ROOT, POINTS, ANCHOR, CAGE, PROXY = "root", "points", "anchor", "cage", "proxy"
_SHEAR = 1e-3


def add_bundle(context: bpy.types.Context, bundle: Bundle) -> bpy.types.Object:
    """Put all of a bundle under one empty, whose place, turn and scale are free; return it."""
    name = bundle.about.get("run") or "object"
    collection = bpy.data.collections.new(f"pcore {name}")
    context.scene.collection.children.link(collection)
    root = _add(collection, None, f"pcore {name}", ROOT)
    root[FOLDER] = str(bundle.folder.resolve())
    root.scale = [float(bundle.about.get("scale", 1.0))] * 3
    # Captures may lie in their world: what was up for the photographer is up here.
    axes = Matrix(bundle.about.get("axes", np.eye(3).tolist()))
    root.rotation_mode = "QUATERNION"
    root.rotation_quaternion = axes.transposed().to_quaternion()
    root.empty_display_size = 0.1 * bundle.about["size"]
    _add_mesh(collection, root, "points", POINTS, bundle.mesh("points"))
    proxy = _add_mesh(collection, root, "proxy", PROXY, bundle.mesh("proxy"))
    proxy.data.materials.append(_painted())
    add_cage_mesh(root, bundle)
    for number, near in enumerate(bundle.json("anchors")["near"]):
        add_anchor(root, bundle, f"anchor {number:03}", near)
    return root


def add_cage_mesh(root: bpy.types.Object, bundle: Bundle) -> bpy.types.Object:
    """Put the cage of a bundle under its empty; return it."""
    cage = _add_mesh(root.users_collection[0], root, "cage", CAGE, bundle.mesh("cage"))
    cage.display_type = "WIRE"
    cage.hide_render = True
    return cage


def add_anchor(root: bpy.types.Object, bundle: Bundle, name: str, near) -> bpy.types.Object:
    """Put an empty at a place of the run, under the empty of its bundle; return it."""
    anchor = add_object(root, name, ANCHOR)
    anchor.location = near
    anchor[NEAR] = [float(x) for x in near]
    anchor.rotation_mode = "QUATERNION"
    anchor.empty_display_type = "SPHERE"
    anchor.empty_display_size = 0.008 * bundle.about["size"]
    return anchor


def add_object(root: bpy.types.Object, name: str, role: str, data=None) -> bpy.types.Object:
    """Put an object under the empty of a bundle; None as data makes an empty."""
    return _add(root.users_collection[0], root, name, role, data)


def root_of(context: bpy.types.Context) -> bpy.types.Object:
    """Return the empty of the bundle that the active object belongs to, or of the only one.

    Raises:
        BridgeError: there is none, or there are several and none is active.
    """
    one = context.view_layer.objects.active
    while one is not None and one.get(ROLE) != ROOT:
        one = one.parent
    roots = [item for item in context.scene.objects if item.get(ROLE) == ROOT]
    if one is None and len(roots) != 1:
        raise BridgeError(
            f"expected one bundle in the scene, got {len(roots)}; "
            + ("select one of its objects" if roots else "import one first")
        )
    return one or roots[0]


def bundle_of(root: bpy.types.Object) -> Bundle:
    """Return the bundle that the objects came from, checked again."""
    return open_bundle(Path(root[FOLDER]))


def members(root: bpy.types.Object, role: str) -> list[bpy.types.Object]:
    """Return all objects of a bundle with this role."""
    return [item for item in root.children_recursive if item.get(ROLE) == role]


def member(root: bpy.types.Object, role: str) -> bpy.types.Object:
    """Return the object of a bundle with this role."""
    found = members(root, role)
    if len(found) != 1:
        raise BridgeError(f"expected one object that is the {role} of the bundle, got {len(found)}")
    return found[0]


def frames_of(context: bpy.types.Context, *, moving: bool) -> Iterator[bpy.types.Depsgraph]:
    """Go through all frames of the scene, or stay at this one; the frame is put back at the end."""
    scene = context.scene
    now, part = scene.frame_current, scene.frame_subframe
    numbers = range(scene.frame_start, scene.frame_end + 1) if moving else [now]
    try:
        for number in numbers:
            if moving:
                scene.frame_set(number)
            yield context.evaluated_depsgraph_get()
    finally:
        if moving:
            scene.frame_set(now, subframe=part)


def place_of(
    item: bpy.types.Object, root: bpy.types.Object, graph: bpy.types.Depsgraph
) -> np.ndarray:
    """(4, 4) from the object's own coordinates to those of the run.

    Raises:
        BridgeError: it is mirrored, or squashed flat.
    """
    own, base = (
        np.array(one.evaluated_get(graph).matrix_world, dtype=np.float64) for one in (item, root)
    )
    for one, matrix in ((item, own), (root, base)):
        if not np.linalg.det(matrix[:3, :3]) > 0:
            raise BridgeError(
                f"{one.name}: its scale is negative or 0, which mirrors or flattens it; apply the "
                "scale or make it positive"
            )
    return np.linalg.solve(base, own)


def place_and_turn(name: str, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """Place (3,), rotation (3, 3), and whether there is also a scale, of a matrix (4, 4).

    Raises:
        BridgeError: it is sheared.
    """
    sides = np.linalg.norm(matrix[:3, :3], axis=0)
    turn = matrix[:3, :3] / sides
    if np.abs(turn.T @ turn - np.eye(3)).max() > _SHEAR:
        raise BridgeError(
            f"{name}: it is sheared, by a parent that is scaled unevenly; apply the scale of its "
            "parents"
        )
    return matrix[:3, 3], turn, bool(np.abs(sides - 1).max() > _SHEAR)


def shape_of(
    item: bpy.types.Object, root: bpy.types.Object, graph: bpy.types.Depsgraph, rest: Mesh
) -> np.ndarray:
    """(V, 3) float32 vertices under all modifiers, in coordinates of the run.

    Raises:
        BridgeError: they are not the vertices and triangles of `rest`.
    """
    matrix = place_of(item, root, graph)
    evaluated = item.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    try:
        places = _array(mesh.vertices, "co", np.float32, 3)
        corners = _array(mesh.loops, "vertex_index", np.int32, 1)
        same = len(mesh.polygons) == len(rest.faces) and len(places) == len(rest.vertices)
    finally:
        evaluated.to_mesh_clear()
    if not same or not np.array_equal(corners.ravel(), rest.faces.ravel()):
        raise BridgeError(
            f"{item.name}: expected the {len(rest.vertices)} vertices and {len(rest.faces)} "
            f"triangles of the bundle in their order, got {len(places)} vertices; take away what "
            "changes its topology (subdivision, remesh, decimate, edits that add or remove)"
        )
    if not np.isfinite(places).all():
        raise BridgeError(f"{item.name}: has vertices that are not finite")
    if np.array_equal(matrix, np.eye(4)):
        return places
    return (places @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)


def rest_places(item: bpy.types.Object) -> np.ndarray:
    """(V, 3) float32 vertices of a mesh without shape keys and modifiers."""
    keys = item.data.shape_keys
    return _array(item.data.vertices if keys is None else keys.reference_key.data, "co", "f4", 3)


def _array(items, name: str, kind, width: int) -> np.ndarray:
    values = np.empty(len(items) * width, dtype=kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width)


def _add(collection, parent, name, role, data=None) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    item[ROLE] = role
    item.parent = parent
    collection.objects.link(item)
    return item


def _add_mesh(collection, root, name, role, content: Mesh) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(content.vertices, [], content.faces)
    if content.colors is not None:
        paint = mesh.color_attributes.new("Color", "BYTE_COLOR", "POINT")
        opaque = np.concatenate([content.colors, np.ones((len(content.colors), 1))], axis=1)
        paint.data.foreach_set("color_srgb", opaque.astype(np.float32).ravel())
    mesh.update()
    return _add(collection, root, name, role, mesh)


def _painted() -> bpy.types.Material:
    """Return a material that shows the colours of the vertices as they are."""
    material = bpy.data.materials.new("pcore colours")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    colour = tree.nodes.new("ShaderNodeVertexColor")
    colour.layer_name = "Color"
    light = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(colour.outputs["Color"], light.inputs["Color"])
    tree.links.new(light.outputs["Emission"], output.inputs["Surface"])
    return material

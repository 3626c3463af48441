"""What poses a bundle with what Blender has: handles, pins, cages, lattices, bones."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Vector

from .bundle import BridgeError, Bundle
from .scene import (
    ANCHOR,
    CAGE,
    NEAR,
    PIN,
    PROXY,
    add_anchor,
    add_cage_mesh,
    add_object,
    bundle_of,
    member,
    members,
    rest_places,
    root_of,
)

_FAR = 0.25
"""How far from the object the cursor may be: a share of its size."""
_ROOM = 0.02
"""By how much a lattice is larger than what it holds, on either side."""
_INFLUENCES = 4
"""Bones that a vertex of the proxy follows."""


def add_handle(context: bpy.types.Context, *, pin: bool) -> tuple[bpy.types.Object, str]:
    """Put an empty on the point nearest to the 3D cursor, to drag or to hold what is there.

    Returns:
        The empty, which is active then, and what was done.

    Raises:
        BridgeError: the cursor is nowhere near the object, or an empty to drag is there already.
    """
    root = root_of(context)
    bundle = bundle_of(root)
    base = np.array(root.matrix_world, dtype=np.float64)
    if not np.linalg.det(base[:3, :3]) > 0:
        raise BridgeError(f"{root.name}: its scale is negative or 0; make it positive")
    cursor = np.linalg.solve(base, [*context.scene.cursor.location, 1.0])[:3]
    places = bundle.mesh("points").vertices.astype(np.float64)
    away = np.linalg.norm(places - cursor, axis=1)
    nearest = int(away.argmin())
    if away[nearest] > _FAR * bundle.about["size"]:
        raise BridgeError(
            f"the 3D cursor is {away[nearest]:.3g} away from the object, which is "
            f"{bundle.about['size']:.3g} large; put it on the object (Shift and the right button)"
        )
    near = [float(x) for x in places[nearest]]
    slack = 1e-6 * bundle.about["size"]
    known = [
        item for item in members(root, ANCHOR) if np.abs(np.array(item[NEAR]) - near).max() <= slack
    ]
    if known and not pin:
        raise BridgeError(f"{known[0].name} is at this very place already; drag that one")
    item = known[0] if known else add_anchor(root, bundle, "pin" if pin else "handle", near)
    if pin:
        item[PIN] = True
    _activate(context, item)
    return item, f"{item.name} {'holds' if pin else 'is on'} point {nearest}"


def add_cage(context: bpy.types.Context) -> bpy.types.Object:
    """Put the cage of the bundle back where it was taken away.

    Raises:
        BridgeError: it is there.
    """
    root = root_of(context)
    if members(root, CAGE):
        raise BridgeError(f"{member(root, CAGE).name}: the cage is there; delete it for a new one")
    cage = add_cage_mesh(root, bundle_of(root))
    _activate(context, cage)
    return cage


def add_lattice(context: bpy.types.Context, role: str, resolution: int) -> bpy.types.Object:
    """Put a lattice around the cage, the proxy or the points, and let it bend them.

    Args:
        context: of Blender.
        role: of what is bent.
        resolution: points of the lattice along each axis, at least 2.

    Raises:
        BridgeError: a lattice bends it already, or no part of the bundle has this role.
    """
    root = root_of(context)
    item = member(root, role)
    if any(one.type == "LATTICE" for one in item.modifiers):
        raise BridgeError(f"{item.name}: a lattice bends it already; take that modifier away first")
    places = rest_places(item)
    low, high = places.min(axis=0), places.max(axis=0)
    room = _ROOM * float((high - low).max())
    data = bpy.data.lattices.new(f"{item.name} lattice")
    data.points_u = data.points_v = data.points_w = resolution
    lattice = add_object(root, data.name, "lattice", data)
    lattice.location = (low + high) / 2
    # Where the object is flat a lattice without thickness would bend nothing.
    lattice.scale = np.maximum(high - low, room) + 2 * room
    item.modifiers.new("pcore lattice", "LATTICE").object = lattice
    item.hide_set(False)
    _activate(context, lattice)
    return lattice


def bind_armature(context: bpy.types.Context, *, chain: bool) -> bpy.types.Object:
    """Make bones at the selected anchors, which carry those and bend the proxy.

    Args:
        context: Blender's.
        chain: each bone ends where the next anchor is, from the active one on, and carries it
            along; otherwise every bone stands by itself.

    Raises:
        BridgeError: fewer than two anchors are selected, they have moved, or bones carry them.
    """
    root = root_of(context)
    bundle = bundle_of(root)
    chosen = [item for item in members(root, ANCHOR) if item.select_get()]
    if len(chosen) < 2:
        raise BridgeError(
            f"expected at least two selected anchors to put bones at, got {len(chosen)}; select "
            "empties on a limb, the one it begins at last"
        )
    for item in chosen:
        if item.constraints:
            raise BridgeError(f"{item.name}: has constraints already; take them away first")
        if (
            np.abs(np.array(item.location) - np.array(item[NEAR])).max()
            > 1e-6 * bundle.about["size"]
        ):
            raise BridgeError(f"{item.name}: was moved already; put it back (Alt-G) and bind first")
    if len({tuple(item[NEAR]) for item in chosen}) < len(chosen):
        raise BridgeError("two of the selected anchors are at one place; delete one of them")
    ordered = _along(chosen, context.view_layer.objects.active)
    armature = add_object(root, "pcore bones", "armature", bpy.data.armatures.new("pcore bones"))
    names, segments = _make_bones(context, armature, ordered, bundle, chain)
    for item, name in zip(ordered, names, strict=True):
        tie = item.constraints.new("CHILD_OF")
        tie.target, tie.subtarget = armature, name
        pose = armature.matrix_world @ armature.pose.bones[name].matrix
        tie.inverse_matrix = pose.inverted()
    if members(root, PROXY):
        _weigh(member(root, PROXY), armature, names, segments)
    _activate(context, armature)
    return armature


def _along(chosen: list, active) -> list:
    """Anchors from the active one on, each the nearest of those that are left."""
    left = list(chosen)
    ordered = [left.pop(left.index(active) if active in left else 0)]
    while left:
        last = Vector(ordered[-1][NEAR])
        ordered.append(
            left.pop(min(range(len(left)), key=lambda k: (Vector(left[k][NEAR]) - last).length))
        )
    return ordered


def _make_bones(context, armature, ordered: list, bundle: Bundle, chain: bool):
    """Bones of an armature; their names, and their ends (B, 2, 3)."""
    heads = np.array([item[NEAR] for item in ordered], dtype=np.float64)
    up = np.array([0.0, 0.0, 0.05 * bundle.about["size"]])
    tails = heads + up
    if chain:
        tails = np.concatenate([heads[1:], [2 * heads[-1] - heads[-2]]])
    _activate(context, armature)
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        names, before = [], None
        for item, head, tail in zip(ordered, heads, tails, strict=True):
            bone = armature.data.edit_bones.new(item.name)
            bone.head, bone.tail = head, tail
            if chain and before is not None:
                bone.parent = before
            names.append(bone.name)
            before = bone
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    context.view_layer.update()
    return names, np.stack([heads, tails], axis=1)


def _weigh(proxy, armature, names: list[str], segments: np.ndarray) -> None:
    """Let a mesh follow bones: by the fourth power of how near they are, the nearest few."""
    places = rest_places(proxy).astype(np.float64)
    first, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    away = places[:, None] - first
    share = np.clip((away * way).sum(-1) / (way * way).sum(-1), 0.0, 1.0)
    squared = ((away - share[..., None] * way) ** 2).sum(-1)
    weight = 1.0 / (squared + 1e-8 * squared.max()) ** 2
    least = -np.sort(-weight, axis=1)[:, min(_INFLUENCES, len(names)) - 1]
    weight = np.where(weight >= least[:, None], weight, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    for number, name in enumerate(names):
        group = proxy.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(weight[:, number] > 1e-4):
            group.add([int(vertex)], float(weight[vertex, number]), "REPLACE")
    proxy.modifiers.new("pcore bones", "ARMATURE").object = armature


def _activate(context: bpy.types.Context, item: bpy.types.Object) -> None:
    for other in context.view_layer.objects:
        other.select_set(False)
    item.select_set(True)
    context.view_layer.objects.active = item

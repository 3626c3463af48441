"""The shape that a glTF file shows: nodes where they are, morph targets and skins as they stand.

Animations are not played: the pose is the one that the nodes, the weights of morph targets and
the joints have in the file, as viewers show it before they play anything.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.data.gltf import Glb, Mesh, Node, Primitive, refuse_extension
from pcore.data.gltf_arrays import item, read_accessor
from pcore.errors import InputError

FloatArray = NDArray[np.float64]
Faces = NDArray[np.int64]

_STRIP, _FAN = 5, 6
_TRIANGLES = (4, _STRIP, _FAN)
_INSTANCES = "EXT_mesh_gpu_instancing"
_VISIBILITY = "KHR_node_visibility"
_DRACO = "KHR_draco_mesh_compression"


def read_shape(glb: Glb) -> tuple[FloatArray, Faces]:
    """Vertices (V, 3) in the frame of the scene and triangles (F, 3) of all its parts.

    Raises:
        InputError: damaged, compressed, or with something that is not read; the message names it.
    """
    # Numbers that grow beyond all bounds are no error here: who reads looks at the result.
    with np.errstate(over="ignore", invalid="ignore"):
        return _joined(glb)


def _joined(glb: Glb) -> tuple[FloatArray, Faces]:
    """As `read_shape`."""
    world = _world_matrices(glb)
    vertices: list[FloatArray] = []
    faces: list[Faces] = []
    count = 0
    for number, mesh, primitive in shown_primitives(glb):
        node = glb.document.nodes[number]
        weights = mesh.weights if node.weights is None else node.weights
        places = _places(glb, primitive, weights)
        corners = primitive_faces(glb, primitive, len(places))
        if node.skin is None and np.linalg.det(world[number][:3, :3]) < 0:
            corners = corners[:, ::-1]  # A mirrored part would be inside out.
        faces.append(corners + count)
        vertices.append(_posed(glb, node, primitive, places, world, number))
        count += len(places)
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    return np.concatenate(vertices), np.concatenate(faces)


def shown_primitives(glb: Glb) -> Iterator[tuple[int, Mesh, Primitive]]:
    """What is made of triangles in the scene that is shown, in the order of `read_shape`.

    Yields:
        Number of the node, its mesh, and one of the mesh's primitives.

    Raises:
        InputError: nodes that form no tree, or instances.
    """
    for number in _shown(glb):
        node = glb.document.nodes[number]
        if _INSTANCES in node.extensions:
            raise refuse_extension(_INSTANCES, glb.where)
        if node.mesh is None:
            continue
        mesh = item(glb.document.meshes, node.mesh, "meshes", glb.where)
        for primitive in mesh.primitives:
            if primitive.mode in _TRIANGLES:
                yield number, mesh, primitive


def _shown(glb: Glb) -> list[int]:
    """Numbers of the nodes of the scene that is shown, parents before children."""
    document = glb.document
    if document.scenes:
        chosen = item(document.scenes, document.scene or 0, "scenes", glb.where)
        waiting = [*reversed(chosen.nodes)]
    else:
        below = {child for node in document.nodes for child in node.children}
        waiting = [k for k in reversed(range(len(document.nodes))) if k not in below]
    shown: list[int] = []
    while waiting:
        number = waiting.pop()
        node = item(document.nodes, number, "nodes", glb.where)
        if node.extensions.get(_VISIBILITY) == {"visible": False}:
            continue
        shown.append(number)
        waiting += reversed(node.children)
        if len(shown) > len(document.nodes):
            raise _no_tree(glb)
    return shown


def _world_matrices(glb: Glb) -> list[FloatArray]:
    """For each node the matrix (4, 4) from its frame to that of the scene."""
    nodes = glb.document.nodes
    parent: dict[int, int] = {}
    for number, node in enumerate(nodes):
        for child in node.children:
            item(nodes, child, "nodes", glb.where)
            if parent.setdefault(child, number) != number:
                raise _no_tree(glb)
    local = [_matrix(node, glb.where) for node in nodes]
    found: dict[int, FloatArray] = {}
    for number in range(len(nodes)):
        chain = [number]
        while chain[-1] in parent and chain[-1] not in found:
            chain.append(parent[chain[-1]])
            if len(chain) > len(nodes):
                raise _no_tree(glb)
        for one in reversed(chain):
            if one not in found:
                above = found[parent[one]] if one in parent else np.eye(4)
                found[one] = above @ local[one]
    return [found[number] for number in range(len(nodes))]


def _no_tree(glb: Glb) -> InputError:
    return InputError(
        f"{glb.where}: expected nodes that form a tree, got one below two others or below itself; "
        "the file is damaged"
    )


def _matrix(node: Node, where: str) -> FloatArray:
    if node.matrix is not None:
        return np.array(node.matrix, dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.rotation
    length = float(np.linalg.norm(node.rotation))
    if not 0 < length < np.inf:
        raise InputError(f"{where}: expected a rotation of a node, got {node.rotation}")
    x, y, z, w = x / length, y / length, z / length, w / length
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.scale)
    matrix[:3, 3] = node.translation
    return matrix


def _places(glb: Glb, primitive: Primitive, weights: list[float]) -> FloatArray:
    """Vertices (V, 3) in the frame of their node, morph targets added."""
    _check_draco(glb, primitive)
    if "POSITION" not in primitive.attributes:
        raise InputError(f"{glb.where}: expected a mesh with POSITION, got one without")
    places = read_accessor(glb, primitive.attributes["POSITION"], "VEC3").astype(np.float64)
    if weights and len(weights) != len(primitive.targets):
        raise InputError(
            f"{glb.where}: expected {len(primitive.targets)} weights, one for each morph target, "
            f"got {len(weights)}; the file is damaged"
        )
    for weight, target in zip(weights, primitive.targets, strict=bool(weights)):
        if weight and "POSITION" in target:
            offset = read_accessor(glb, target["POSITION"], "VEC3")
            if offset.shape != places.shape:
                raise InputError(
                    f"{glb.where}: expected a morph target of {len(places)} vertices, got "
                    f"{len(offset)}; the file is damaged"
                )
            places = places + weight * offset
    return places


def _check_draco(glb: Glb, primitive: Primitive) -> None:
    """Refuse compressed data, unless the file has the same without compression beside it."""
    if not any("draco" in name for name in primitive.extensions):
        return
    numbers = [primitive.attributes.get("POSITION"), primitive.indices]
    plain = [
        item(glb.document.accessors, number, "accessors", glb.where).bufferView
        for number in numbers
        if number is not None
    ]
    if None in plain:
        raise refuse_extension(_DRACO, glb.where)


def _posed(
    glb: Glb,
    node: Node,
    primitive: Primitive,
    places: FloatArray,
    world: list[FloatArray],
    number: int,
) -> FloatArray:
    """Vertices (V, 3) in the frame of the scene; a skin replaces the place of the node."""
    if node.skin is None:
        return places @ world[number][:3, :3].T + world[number][:3, 3]
    skin = item(glb.document.skins, node.skin, "skins", glb.where)
    carried = np.stack([item(world, joint, "nodes", glb.where) for joint in skin.joints])
    if skin.inverseBindMatrices is not None:
        rest = read_accessor(glb, skin.inverseBindMatrices, "MAT4").astype(np.float64)
        if len(rest) < len(carried):
            raise InputError(
                f"{glb.where}: expected {len(carried)} inverse bind matrices of a skin, got "
                f"{len(rest)}; the file is damaged"
            )
        carried = carried @ rest[: len(carried)].reshape(-1, 4, 4).transpose(0, 2, 1)
    joints, weights = _influences(glb, primitive, len(places))
    wrong = joints[(joints < 0) | (joints >= len(carried))]
    if wrong.size:
        raise InputError(
            f"{glb.where}: expected joints from 0 to {len(carried) - 1}, got {int(wrong[0])}; the "
            "file is damaged"
        )
    blended = np.einsum("vj,vjik->vik", weights, carried[joints][:, :, :3])
    return np.einsum("vik,vk->vi", blended[:, :, :3], places) + blended[:, :, 3]


def _influences(glb: Glb, primitive: Primitive, count: int) -> tuple[Faces, FloatArray]:
    """Joints (V, 4 S) and weights (V, 4 S) of sum 1, of the S sets that a primitive has."""
    joints: list[Faces] = []
    weights: list[FloatArray] = []
    number = 0
    while f"JOINTS_{number}" in primitive.attributes:
        joints.append(_rows(glb, primitive, f"JOINTS_{number}", count).astype(np.int64))
        weights.append(_rows(glb, primitive, f"WEIGHTS_{number}", count).astype(np.float64))
        number += 1
    if not joints:
        raise InputError(
            f"{glb.where}: expected weights of the vertices of a skin (JOINTS_0), got none; apply "
            "the armature before exporting"
        )
    share = np.concatenate(weights, axis=1)
    total = share.sum(axis=1, keepdims=True)
    lonely = int((~(total > 0)).sum())
    if lonely:
        raise InputError(
            f"{glb.where}: expected weights of all {count} vertices of a skin, got none for "
            f"{lonely}; weight them, or apply the armature before exporting"
        )
    return np.concatenate(joints, axis=1), share / total


def _rows(glb: Glb, primitive: Primitive, name: str, count: int) -> NDArray[Any]:
    """Four numbers of every vertex: (count, 4)."""
    if name not in primitive.attributes:
        raise InputError(f"{glb.where}: expected {name} of a skin, got none; the file is damaged")
    values = read_accessor(glb, primitive.attributes[name], "VEC4")
    if len(values) != count:
        raise InputError(
            f"{glb.where}: expected {count} rows of {name}, got {len(values)}; the file is damaged"
        )
    return values


def primitive_faces(glb: Glb, primitive: Primitive, count: int) -> Faces:
    """Triangles (F, 3) of a list, a strip or a fan of vertices."""
    if primitive.indices is None:
        order = np.arange(count)
    else:
        order = read_accessor(glb, primitive.indices, "SCALAR")[:, 0].astype(np.int64)
    if order.size and int(order.max()) >= count:
        raise InputError(
            f"{glb.where}: expected faces that refer to vertices 0 to {count - 1}, got "
            f"{int(order.max())}; the file is damaged"
        )
    if primitive.mode in (_STRIP, _FAN) and len(order) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if primitive.mode == _STRIP:
        faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        # Every second triangle of a strip runs backwards.
        faces[1::2] = faces[1::2][:, [0, 2, 1]]
        return faces
    if primitive.mode == _FAN:
        return np.stack([np.broadcast_to(order[:1], len(order) - 2), order[1:-1], order[2:]], 1)
    if len(order) % 3:
        raise InputError(
            f"{glb.where}: expected three corners for each triangle, got {len(order)} in all; the "
            "file is damaged"
        )
    return order.reshape(-1, 3)

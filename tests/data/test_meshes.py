"""Meshes of other tools: the shape that the file shows, or an error that names what is not read."""

import base64
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE, FACES, Builder, cube, glb

from pcore.data.meshes import read_mesh
from pcore.errors import InputError

HALF = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
"""A quarter turn about z as a quaternion."""
QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def at(*offset: float) -> np.ndarray:
    """The cube elsewhere."""
    return CUBE + np.array(offset)


def read(tmp_path: Path, content: bytes, name: str = "a.glb") -> tuple[np.ndarray, np.ndarray]:
    (tmp_path / name).write_bytes(content)
    mesh = read_mesh(tmp_path / name)
    return mesh.vertices.numpy(), mesh.faces.numpy()


def moved(made: Builder) -> np.ndarray:
    made.node.update(translation=[1, 2, 3], rotation=HALF, scale=[2, 1, 1])
    return (CUBE * [2, 1, 1]) @ QUARTER.T + [1, 2, 3]


def nested(made: Builder) -> np.ndarray:
    made.tree["nodes"] = [
        {"children": [1], "scale": [2, 2, 2]},
        {"children": [2], "rotation": HALF},
        {"mesh": 0, "translation": [0, 0, 1]},
    ]
    return 2 * at(0, 0, 1) @ QUARTER.T


def matrix(made: Builder) -> np.ndarray:
    made.node["matrix"] = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]
    return CUBE @ QUARTER.T + [5, 6, 7]


def morphed(made: Builder) -> np.ndarray:
    made.primitive["targets"] = [
        {"POSITION": made.array(np.ones((8, 3)))},
        {"POSITION": made.array(CUBE)},
        {"NORMAL": made.array(CUBE)},
    ]
    made.tree["meshes"][0]["weights"] = [0.5, 0.25, 1]
    return 1.25 * CUBE + 0.5


def morphed_by_its_node(made: Builder) -> np.ndarray:
    morphed(made)
    made.node["weights"] = [0, 1, 0]
    return 2 * CUBE


def morphed_sparsely(made: Builder) -> np.ndarray:
    """Blender writes the rows that a shape key moves, and no buffer view."""
    rows, values = made.view(np.array([1, 6]), "u1"), made.view(np.ones((2, 3)), "f4")
    sparse = {
        "count": 2,
        "indices": {"bufferView": rows, "componentType": 5121},
        "values": {"bufferView": values},
    }
    made.primitive["targets"] = [{"POSITION": made.accessor(None, 8, 3, "f4", sparse=sparse)}]
    made.tree["meshes"][0]["weights"] = [2.0]
    expected = CUBE.copy()
    expected[[1, 6]] += 2
    return expected


def sparse_places(made: Builder) -> np.ndarray:
    rows, values = made.view(np.array([0, 7]), "u2"), made.view(np.full((2, 3), 9.0), "f4")
    made.tree["accessors"][0]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": rows, "componentType": 5123},
        "values": {"bufferView": values},
    }
    expected = CUBE.copy()
    expected[[0, 7]] = 9
    return expected


def skinned(made: Builder) -> np.ndarray:
    """Two joints; the node's own place does not count, the joints' places do."""
    weights = np.zeros((8, 4))
    weights[:, 1] = CUBE[:, 2]
    weights[:, 0] = 1 - CUBE[:, 2]
    joints = np.tile([1, 0, 0, 0], (8, 1))
    rest = np.stack([np.eye(4), np.eye(4)])
    rest[0, :3, 3] = [0, 0, -1]
    made.primitive["attributes"] |= {
        "JOINTS_0": made.array(joints, "u1"),
        "WEIGHTS_0": made.array(weights),
    }
    binds = made.array(rest.transpose(0, 2, 1).reshape(2, 16))
    made.tree["skins"] = [{"joints": [2, 1], "inverseBindMatrices": binds}]
    made.tree["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},
        {"children": [2], "translation": [0, 0, 0.5]},
        {"translation": [0, 0, 1], "rotation": HALF},
    ]
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    top = (CUBE - [0, 0, 1]) @ QUARTER.T + [0, 0, 1.5]
    share = CUBE[:, 2:]
    return share * top + (1 - share) * at(0, 0, 0.5)


def skinned_with_bytes(made: Builder) -> np.ndarray:
    """Weights as normalised bytes, which need not sum to 255; joints without bind matrices."""
    made.primitive["attributes"] |= {
        "JOINTS_0": made.array(np.tile([1, 2, 0, 0], (8, 1)), "u2"),
        "WEIGHTS_0": made.array(np.tile([127, 127, 0, 0], (8, 1)), "u1", normalized=True),
    }
    made.tree["skins"] = [{"joints": [0, 1, 2]}]
    made.tree["nodes"] = [{"mesh": 0, "skin": 0}, {"translation": [2, 0, 0]}, {"scale": [2, 2, 2]}]
    made.tree["scenes"] = [{"nodes": [0, 1, 2]}]
    return 0.5 * at(2, 0, 0) + 0.5 * (2 * CUBE)


def skinned_in_two_sets(made: Builder) -> np.ndarray:
    """More than four joints at a vertex."""
    made.primitive["attributes"] |= {
        f"JOINTS_{k}": made.array(np.tile([k, 0, 0, 0], (8, 1)), "u1") for k in range(2)
    }
    made.primitive["attributes"] |= {
        f"WEIGHTS_{k}": made.array(np.tile([0.5, 0, 0, 0], (8, 1))) for k in range(2)
    }
    made.tree["skins"] = [{"joints": [1, 2]}]
    made.tree["nodes"] = [{"mesh": 0, "skin": 0}, {"translation": [2, 0, 0]}, {}]
    return at(1, 0, 0)


def quantised(made: Builder) -> np.ndarray:
    """As gltfpack -noq leaves out and gltfpack writes: 16 bits, with the node's scale."""
    made.primitive["attributes"]["POSITION"] = made.array(CUBE * 16000, "u2")
    made.tree |= {"extensionsRequired": ["KHR_mesh_quantization"]}
    made.node.update(scale=[1 / 16000] * 3)
    return CUBE


def normalised(made: Builder) -> np.ndarray:
    signed = made.array((CUBE * 2 - 1) * 127, "i1", normalized=True)
    made.primitive["attributes"]["POSITION"] = signed
    return CUBE * 2 - 1


def interleaved(made: Builder) -> np.ndarray:
    both = np.concatenate([CUBE + 7, CUBE], axis=1)
    view = made.view(both, "f4", byteStride=24)
    made.primitive["attributes"]["POSITION"] = made.accessor(view, 8, 3, "f4", byteOffset=12)
    return CUBE


def second_scene(made: Builder) -> np.ndarray:
    made.tree["nodes"] = [{"mesh": 0}, {"mesh": 0, "scale": [3, 3, 3]}]
    made.tree |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    return 3 * CUBE


def no_scene(made: Builder) -> np.ndarray:
    del made.tree["scenes"]
    return CUBE


def data_in_the_json(made: Builder) -> np.ndarray:
    text = base64.b64encode(made.binary).decode()
    uri = f"data:application/octet-stream;base64,{text}"
    made.tree["buffers"] = [{"byteLength": len(made.binary), "uri": uri}]
    made.binary = b""
    return CUBE


def draco_beside(made: Builder) -> np.ndarray:
    """Compressed, with the same data uncompressed for readers without Draco."""
    made.primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    made.tree["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    return CUBE


def materials(made: Builder) -> np.ndarray:
    made.tree["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_basisu"]
    made.tree["materials"] = [{"name": "a"}]
    made.primitive["material"] = 0
    return CUBE


def seams(made: Builder) -> np.ndarray:
    """Vertices that textures split are vertices of their own."""
    twice = np.concatenate([CUBE, CUBE])
    made.primitive["attributes"]["POSITION"] = made.array(twice)
    return twice


SHAPES: list[Callable[[Builder], np.ndarray]] = [
    moved, nested, matrix, morphed, morphed_by_its_node, morphed_sparsely, sparse_places, skinned,
    skinned_with_bytes, skinned_in_two_sets, quantised, normalised, interleaved, second_scene,
    no_scene, data_in_the_json, draco_beside, materials, seams,
]  # fmt: skip


@pytest.mark.parametrize("shape", SHAPES, ids=lambda one: one.__name__)
def test_the_shape_that_a_glb_shows(tmp_path: Path, shape: Callable[[Builder], np.ndarray]):
    made = cube()
    expected = shape(made)
    vertices, faces = read(tmp_path, made.content())
    np.testing.assert_allclose(vertices, expected, atol=1e-6)
    np.testing.assert_array_equal(faces, FACES)


@pytest.mark.parametrize(
    ("mode", "order", "faces"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3, 4], [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, [0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]]),
    ],
)
@pytest.mark.parametrize("kind", ["u1", "u2", "u4", None])
def test_lists_strips_and_fans(tmp_path: Path, mode: int, order: list[int], faces, kind):
    made = cube()
    made.primitive["mode"] = mode
    if kind is None:
        del made.primitive["indices"]
        made.primitive["attributes"]["POSITION"] = made.array(CUBE[order])
        vertices, found = read(tmp_path, made.content())
        np.testing.assert_allclose(vertices[found], CUBE[np.array(faces)], atol=1e-6)
        return
    made.primitive["indices"] = made.array(np.array(order), kind)
    assert read(tmp_path, made.content())[1].tolist() == faces


def test_parts_are_joined(tmp_path: Path):
    made = cube()
    made.tree["meshes"][0]["primitives"] *= 2
    made.tree["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}, "mode": 1})
    made.tree["nodes"] = [{"children": [1]}, {"mesh": 0, "translation": [0, 0, 4]}, {"mesh": 0}]
    made.tree["scenes"][0]["nodes"] = [2, 0]
    vertices, faces = read(tmp_path, made.content())
    assert vertices.shape == (32, 3)
    np.testing.assert_allclose(vertices[16:], np.tile(at(0, 0, 4), (2, 1)), atol=1e-6)
    np.testing.assert_array_equal(faces, np.concatenate([FACES + 8 * k for k in range(4)]))


def test_up(tmp_path: Path):
    (tmp_path / "a.glb").write_bytes(cube().content())
    x, y, z = CUBE.T
    np.testing.assert_array_equal(
        read_mesh(tmp_path / "a.glb", up="y").vertices.numpy(), np.stack([x, -z, y], axis=1)
    )


def draco(made: Builder) -> None:
    draco_beside(made)
    for accessor in made.tree["accessors"]:
        del accessor["bufferView"]


def meshopt(made: Builder) -> None:
    made.tree["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {"buffer": 0}}


def instances(made: Builder) -> None:
    made.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {}}}


def splats(made: Builder) -> None:
    made.tree["extensionsRequired"] = ["KHR_gaussian_splatting"]


def bare(made: Builder) -> None:
    made.primitive["mode"] = 0


def another_file(made: Builder) -> None:
    made.tree["buffers"] = [{"byteLength": 9, "uri": "cube.bin"}]


def no_data(made: Builder) -> None:
    del made.tree["accessors"][0]["bufferView"]


def loop(made: Builder) -> None:
    made.tree["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [0]}]


def two_parents(made: Builder) -> None:
    made.tree["nodes"] = [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]


def no_weights(made: Builder) -> None:
    skinned(made)
    weights = np.zeros((8, 4))
    weights[:6, 0] = 1
    made.primitive["attributes"]["WEIGHTS_0"] = made.array(weights)


def far_joint(made: Builder) -> None:
    skinned(made)
    made.primitive["attributes"]["JOINTS_0"] = made.array(np.full((8, 4), 5), "u1")


def unbound(made: Builder) -> None:
    skinned(made)
    del made.primitive["attributes"]["JOINTS_0"]


def far_corner(made: Builder) -> None:
    made.primitive["indices"] = made.array(np.array([0, 1, 8]), "u2")


def two_corners(made: Builder) -> None:
    made.primitive["indices"] = made.array(np.array([0, 1]), "u2")


def few_weights(made: Builder) -> None:
    morphed(made)
    made.node["weights"] = [1.0]


def short(made: Builder) -> None:
    made.tree["accessors"][0]["count"] = 10**12


def wrong(made: Builder) -> None:
    made.tree["accessors"][0]["count"] = "many"


def nowhere(made: Builder) -> None:
    made.node["mesh"] = 4


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (draco, "compressed with Draco, which is not read: export without compression"),
        (meshopt, "compressed with meshopt (EXT_meshopt_compression), which is not read: export"),
        (instances, "glTF extension EXT_mesh_gpu_instancing, which is not read: export without"),
        (splats, "glTF extension KHR_gaussian_splatting, which is not read"),
        (bare, "expected a mesh with faces, got 0 bare points"),
        (another_file, "whose numbers lie in 'cube.bin': export glTF Binary (.glb) with its data"),
        (no_data, "expected accessor 0 with data, got none"),
        (loop, "expected nodes that form a tree"),
        (two_parents, "expected nodes that form a tree"),
        (no_weights, "expected weights of all 8 vertices of a skin, got none for 2; weight them"),
        (far_joint, "expected joints from 0 to 1, got 5; the file is damaged"),
        (unbound, "(JOINTS_0), got none; apply the armature before exporting"),
        (far_corner, "expected faces that refer to vertices 0 to 7, got 8"),
        (two_corners, "expected three corners for each triangle, got 2 in all"),
        (few_weights, "expected 3 weights, one for each morph target, got 1"),
        (short, "rows in buffer view 0, got one that is too short"),
        (wrong, "'accessors.0.count'"),
        (nowhere, "one of its 1 meshes, got 4; the file is damaged"),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_what_is_not_read_of_a_glb_is_named(tmp_path: Path, harm, said: str):
    made = cube()
    harm(made)
    assert said in refusal(tmp_path, made.content())


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "got an empty file"),
        (json.dumps(cube().tree).encode(), "got JSON text; export glTF Binary (.glb)"),
        (glb(b"{}", version=1), "expected glTF of version 2, got version 1"),
        (glb(b'{"asset": {"version": "1.0"}}'), "got version '1.0'"),
        (glb(b'{"asset"'), "damaged (its JSON does not parse)"),
        (glb(b"[" * 40000), "damaged (its JSON does not parse)"),
        (glb(b"[]"), "'top level': expected keys with values"),
        (glb(b"{}"), "'asset' is missing"),
        (cube().content()[:-20], "bytes are there): export or download it again"),
        (b"glTF" + bytes([2, 0, 0, 0, 12, 0, 0, 0]), "it has no JSON chunk"),
        (b"Kaydara FBX Binary", "got an FBX file, which is not read; export .ply, .obj or .glb"),
    ],
)
def test_files_that_are_no_glb(tmp_path: Path, content: bytes, said: str):
    assert said in refusal(tmp_path, content)


def refusal(tmp_path: Path, content: bytes, name: str = "a.glb") -> str:
    with pytest.raises(InputError) as caught:
        read(tmp_path, content, name)
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / name}: ")
    return text


CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
SIDES = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.mark.parametrize(
    "text",
    [
        CORNERS + SIDES,
        (CORNERS + SIDES).replace("\n", "\r\n"),
        (CORNERS + SIDES).replace("\n", "\r"),
        (CORNERS + SIDES).replace(" ", "\t"),
        "\ufeff" + CORNERS + SIDES,
        "# Blender 4.2\nmtllib caf\xe9.mtl\no K\xf6rper\n" + CORNERS + "s 1\nusemtl a\n" + SIDES,
        CORNERS + "vt 0 0\nvt 1 0\nvt 0 1\nf 1/1 3/2 2/3\nf 1/3 2/1 4/2\nf 2/2 3/3 4/1\nf 1 4 3",
        CORNERS + "vn 0 0 1\nf 1//1 3//1 2//1\nf 1//1 2//1 4//1\nf 2 3 4\nf 1/1/1 4/1/1 3/1/1\n",
        CORNERS + "f -4 -2 -3\nf -4 -3 -1\nf -3 -2 -1\nf -4 -1 -2\n",
        CORNERS + SIDES.replace("f 1 3 2", "f 1 \\\n3 2"),
        CORNERS.replace("v 0 0 0", "v 0 0 0 1.0") + SIDES,
        # ZBrush and MeshLab write colours behind places.
        CORNERS.replace("\n", " 0.5 0.25 1\n") + SIDES,
        "#MRGB ffff0000\n" + CORNERS + SIDES,
        # Groups and objects that share vertices, which keep their order.
        CORNERS + "g a\nf 1 3 2\nf 1 2 4\ng b\nusemtl x\nf 2 3 4\nf 1 4 3\n",
        "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 3 2\no b\nv 0 0 1\nf 1 2 4\nf 2 3 4\nf 1 4 3\n",
        # Faces before the vertices they name.
        SIDES + CORNERS,
        CORNERS + "l 1 2\np 3\nf 1 2\n" + SIDES,
    ],
)  # fmt: skip
def test_what_other_tools_write_as_obj(tmp_path: Path, text: str):
    encoding = "utf-8" if text.startswith("\ufeff") else "latin-1"
    vertices, faces = read(tmp_path, text.encode(encoding), "a.obj")
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(faces, TETRAHEDRON)


def test_polygons_and_lone_vertices_of_an_obj(tmp_path: Path):
    text = "v 9 9 9\n" + CORNERS + "v 0.5 2 0\nf 2 3 6 4\n"
    vertices, faces = read(tmp_path, text.encode(), "a.obj")
    assert len(vertices) == 6
    assert faces.tolist() == [[1, 2, 5], [1, 5, 3]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CORNERS, "expected a mesh with faces, got 4 bare points"),
        ("hello", "expected a mesh with faces, got 0 bare points"),
        (CORNERS + "f 1 2 5", "expected faces that refer to vertices 1 to 4, got 1, 2, 5"),
        (CORNERS + "f -5 1 2", "expected faces that refer to vertices 1 to 4, got 0, 1, 2"),
        (CORNERS + f"f 1 2 {10**30}", "expected faces that refer to vertices 1 to 4"),
        (CORNERS + "f 1 0 2", "line 5: expected corners V, V/VT, V//VN or V/VT/VN of numbers"),
        (CORNERS + "f 1/x 2 3", "or negative ones, in a face, got '1/x'"),
        (CORNERS + "f a b c", "or negative ones, in a face, got 'a'"),
        ("v 0,5 1 2", "line 1: expected the numbers of a vertex, got '0,5 1 2'; write numbers"),
        ("v 0 1", "line 1: expected a vertex x y z, got 2 numbers"),
        ("v 0 1 2 0.5", "line 1: expected a vertex x y z, got one with the weight 0.5"),
        (CORNERS + "cstype bezier", "line 5: free-form curves and surfaces (cstype) are not read"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "got NaN or infinity in its vertices"),
    ],
)  # fmt: skip
def test_what_is_not_read_of_an_obj_is_named(tmp_path: Path, text: str, said: str):
    assert said in refusal(tmp_path, text.encode(), "a.obj")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.stl", "an STL repeats its corners in every triangle: export another of these"),
        ("a.gltf", "its JSON does not parse"),
        ("a.fbx", "expected a mesh that ends in .ply, .obj, .glb or .gltf, got '.fbx'"),
        ("a", "got 'no ending'"),
    ],
)
def test_other_formats(tmp_path: Path, name: str, said: str):
    assert said in refusal(tmp_path, b"x", name)


def test_a_folder(tmp_path: Path):
    (tmp_path / "a.obj").mkdir()
    with pytest.raises(InputError, match="cannot read a mesh"):
        read_mesh(tmp_path / "a.obj")

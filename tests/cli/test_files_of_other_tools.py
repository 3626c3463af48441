"""Files of points and meshes of other tools, as `pcore deform` and `edit apply` meet them."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.cli.main import main
from pcore.data.points import read_point_file

sys.path.append(str(Path(__file__).resolve().parent.parent / "data"))

from gltf_files import Builder, cube
from ply_files import CORNERS, FACE, MIXED, box, ply

TWIST = {"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 60}]}
FIRST = [217, 163, 130]
LITTLE = "binary_little_endian"
REALS = [k / 7 for k in range(8)]
INSIDE = np.random.default_rng(0).uniform(0.2, 0.8, (40, 3))
HEAD = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
TEXT = f"{HEAD}property float z\nend_header\n" + "".join(f"{x} {y} {z}\n" for x, y, z in CORNERS)


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("twist.json").write_text(json.dumps(TWIST))
    np.save("inside.npy", INSIDE)


def deform(content: bytes, output: str = "o.ply") -> int:
    Path("in.ply").write_bytes(content)
    return main(["deform", "in.ply", "--edit", "twist.json", "-o", output])


def cage(before: str, after: str, **keys: object) -> int:
    edit = {"type": "cage", "before": before, "after": after, **keys}
    Path("cage.json").write_text(json.dumps({"version": 2, "edits": [edit]}))
    return main(["edit", "apply", "inside.npy", "--edit", "cage.json", "-o", "o.npy"])


@pytest.mark.parametrize("encoding", ["ascii", LITTLE])
@pytest.mark.parametrize(("kind", "most"), [("uchar", 255), ("ushort", 65535), ("float", 1.0)])
def test_colours_survive(kind: str, most: float, encoding: str) -> None:
    whole = most > 1
    values = [[round(c * most / 255) if whole else c / 255] * 8 for c in FIRST]
    names = [f"{kind} {c}" for c in ("red", "green", "blue")]
    assert deform(ply(box(*names, values=values), encoding=encoding)) == 0
    assert read_point_file("o.ply").colors[0].tolist() == FIRST
    assert f"property {kind} red" in Path("o.ply").read_bytes().decode("latin-1")


def test_what_is_kept_of_splats_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    names = [f"float {name}" for name in ("f_rest_0", "f_dc_2", "scale_1", "rot_1", "rot_2")]
    assert deform(ply(box(*names, values=[REALS] * 5), encoding=LITTLE)) == 0
    out = capsys.readouterr().out
    kept = "note: not turned, kept as in the file: f_rest_* (1), scale_* (1), rot_* (2)"
    assert kept in " ".join(out.split())
    found = read_point_file("o.ply").ply
    for name in ("f_dc_2", "rot_1"):
        values = found.ply.scalars((found.number, found.vertex.find(name)))
        np.testing.assert_allclose(values, REALS, rtol=1e-6)


def test_what_a_file_of_numbers_cannot_hold_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    content = ply(box("float red", "float nx", values=[REALS, REALS]), FACE)
    assert deform(content, "o.npy") == 0
    assert "note: not in the file that is written: red, nx, 9 face" in capsys.readouterr().out
    main(["edit", "apply", "in.ply", "--edit", "twist.json", "-o", "c.ply", "--colors", "strain"])
    assert "not in the file that is written: red, nx" in capsys.readouterr().out
    found = read_point_file("c.ply")
    assert found.faces.shape == (12, 3)
    assert found.colors.shape == (8, 3)


def test_edit_apply_keeps_a_file_too(capsys: pytest.CaptureFixture[str]) -> None:
    Path("in.ply").write_bytes(ply(box("ushort label", values=[range(8)]), FACE, encoding=LITTLE))
    main(["edit", "apply", "in.ply", "--edit", "twist.json", "-o", "o.ply"])
    assert "warning" not in capsys.readouterr().out
    deform(Path("in.ply").read_bytes(), "d.ply")
    assert Path("o.ply").read_bytes() == Path("d.ply").read_bytes()
    assert b"property ushort label" in Path("o.ply").read_bytes()


def test_normals_turn_with_a_twist() -> None:
    normals = [[1.0, 0.0, 0.0]] * 8
    names = ("float nx", "float ny", "float nz")
    assert deform(ply(box(*names, values=np.array(normals).T.tolist()), encoding=LITTLE)) == 0
    found = read_point_file("o.ply").ply
    places = [(found.number, found.vertex.find(f"n{c}")) for c in "xyz"]
    turned = np.stack([found.ply.scalars(place) for place in places], axis=1)
    before, after = np.array(CORNERS), read_point_file("o.ply").positions.numpy()
    # Of two corners that differ along y only the edge lies in the face that x is across.
    for k in (0, 1, 4, 5):
        assert abs(turned[k] @ (after[k + 2] - after[k])) < 1e-5
        assert before[k + 2, 1] > before[k, 1]
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize("encoding", ["ascii", LITTLE, "binary_big_endian"])
def test_triangles_and_quads(encoding: str) -> None:
    faces = ("face", ("list uchar uint vertex_indices",), MIXED)
    assert deform(ply(box(), faces, encoding=encoding)) == 0
    assert read_point_file("o.ply").faces.shape == (12, 3)
    np.save("inside.npy", INSIDE - 0.5)
    assert cage("in.ply", "in.ply") == 0
    np.testing.assert_array_equal(np.load("o.npy"), INSIDE - 0.5)


LAMP = ("lamp", ("float px", "list uchar float spectrum"), [[1.0, [0.5, 0.25]], [2.0, []]])
LEGAL = {
    "elements behind": ply(box("float radiance_red", values=[REALS]), FACE, LAMP, encoding=LITTLE),
    "lists in vertices": ply(
        box("list uchar float weights", values=[[[0.5] * (k % 3) for k in range(8)]]),
        encoding=LITTLE,
    ),
    "blank line": TEXT.replace("ascii 1.0\n", "ascii 1.0\n\n").encode(),
    "old line ends": TEXT.replace("\n", "\r").encode(),
    "other names of colours": ply(
        box("uchar diffuse_red", "uchar diffuse_green", "uchar diffuse_blue", values=[range(8)] * 3)
    ),
}


@pytest.mark.parametrize("name", LEGAL)
def test_legal_files(name: str) -> None:
    assert deform(TEXT.encode(), "plain.ply") == 0
    assert deform(LEGAL[name]) == 0
    found = read_point_file("o.ply")
    assert torch.equal(found.positions, read_point_file("plain.ply").positions)
    assert (found.colors is not None) == (name == "other names of colours")


def test_supersplat_is_refused_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    chunk = ("chunk", ("float min_x",), [[0.0]])
    packed = ("vertex", ("uint packed_position", "uint packed_color"), [[1, 2]] * 8)
    Path("in.ply").write_bytes(ply(chunk, packed, encoding=LITTLE))
    assert main(["edit", "apply", "in.ply", "--edit", "twist.json", "-o", "o.ply"]) == 2
    error = capsys.readouterr().err
    assert "SuperSplat's compressed PLY is not read" in error
    assert "export an uncompressed one" in " ".join(error.split())
    assert not Path("o.ply").exists()


def put(name: str, made: Builder) -> str:
    Path(name).write_bytes(made.content())
    return name


def skinned() -> Builder:
    made = cube()
    made.primitive["attributes"] |= {
        "JOINTS_0": made.array(np.zeros((8, 4)), "u1"),
        "WEIGHTS_0": made.array(np.tile([1.0, 0, 0, 0], (8, 1))),
    }
    made.tree["skins"] = [{"joints": [1]}]
    made.tree["nodes"] = [{"mesh": 0, "skin": 0}, {"translation": [0, 0.5, 0], "scale": [2, 2, 2]}]
    made.tree["scenes"] = [{"nodes": [0, 1]}]
    return made


def test_a_pose_of_a_skin_moves_the_points() -> None:
    assert cage(put("plain.glb", cube()), put("posed.glb", skinned())) == 0
    np.testing.assert_allclose(np.load("o.npy"), 2 * INSIDE + [0, 0.5, 0], atol=1e-5)


def test_morph_targets_move_the_points() -> None:
    made = cube()
    made.primitive["targets"] = [{"POSITION": made.array(np.tile([0.0, 0, 2], (8, 1)))}]
    made.tree["meshes"][0]["weights"] = [0.25]
    assert cage(put("plain.glb", cube()), put("posed.glb", made)) == 0
    np.testing.assert_allclose(np.load("o.npy"), INSIDE + np.array([0, 0, 0.5]), atol=1e-5)


@pytest.mark.parametrize("both", [True, False])
def test_draco_is_one_error(both: bool, capfd: pytest.CaptureFixture[str]) -> None:
    made = cube()
    made.primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    made.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    for accessor in made.tree["accessors"]:
        del accessor["bufferView"]
    packed = put("draco.glb", made)
    assert cage(packed if both else put("plain.glb", cube()), packed) == 2
    said = capfd.readouterr()
    assert said.out == ""
    assert len(said.err.splitlines()) == 1
    assert "compressed with Draco, which is not read: export without compression" in said.err

"""Files of meshes, read back by other libraries: trimesh and USD's own."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

from pcore.data.mesh_output import MeshMotion, save_mesh
from pcore.errors import DependencyError, InputError
from pcore.geometry.surface_mesh import SurfaceMesh, Texture

BOX = trimesh.creation.box(extents=(2.0, 1.0, 0.5))


def a_mesh(*, texture: bool = False) -> SurfaceMesh:
    vertices = torch.from_numpy(BOX.vertices).double() + torch.tensor([100.0, -50.0, 25.0])
    colors = torch.linspace(0, 1, 24).reshape(8, 3)
    mesh = SurfaceMesh(vertices=vertices, faces=torch.from_numpy(BOX.faces).long(), colors=colors)
    if not texture:
        return mesh
    image = torch.zeros(4, 8, 3)
    image[0, 0, 0] = 1.0  # Red at the upper left.
    places = torch.linspace(0, 1, 16, dtype=torch.float64).reshape(8, 2)
    return replace(mesh, texture=Texture(image=image, coordinates=places))


def motion(mesh: SurfaceMesh) -> MeshMotion:
    frames = [mesh.vertices + torch.tensor([0.0, 0.0, float(k)]) for k in range(3)]
    return MeshMotion(frames=tuple(frames), fps=10.0)


def document(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    (length,) = struct.unpack("<I", content[12:16])
    return json.loads(content[20 : 20 + length])


def numbers(path: Path, accessor: int) -> np.ndarray:
    content, whole = path.read_bytes(), document(path)
    (length,) = struct.unpack("<I", content[12:16])
    view = whole["bufferViews"][whole["accessors"][accessor]["bufferView"]]
    begin = 20 + length + 8 + view["byteOffset"]
    return np.frombuffer(content[begin : begin + view["byteLength"]], dtype="<f4")


@pytest.mark.parametrize("name", ["a.ply", "a.obj"])
def test_trimesh_reads_places_order_and_colours(tmp_path: Path, name: str):
    mesh = a_mesh()
    assert save_mesh(tmp_path / name, mesh) == [tmp_path / name]
    found = trimesh.load(tmp_path / name, process=False)
    np.testing.assert_allclose(found.vertices, mesh.vertices, atol=1e-5)
    np.testing.assert_array_equal(found.faces, mesh.faces)
    np.testing.assert_allclose(
        found.visual.vertex_colors[:, :3] / 255, mesh.colors.numpy(), atol=0.004
    )
    assert found.volume > 0


def test_glb_has_y_up_and_linear_colours(tmp_path: Path):
    mesh = a_mesh()
    save_mesh(tmp_path / "a.glb", mesh)
    found = trimesh.load(tmp_path / "a.glb", process=False).to_geometry()
    x, y, z = mesh.vertices.numpy().T
    np.testing.assert_allclose(found.vertices, np.stack([x, z, -y], axis=1), atol=1e-5)
    assert found.volume == pytest.approx(1.0, rel=1e-3)
    whole = document(tmp_path / "a.glb")
    attributes = whole["meshes"][0]["primitives"][0]["attributes"]
    linear = numbers(tmp_path / "a.glb", attributes["COLOR_0"]).reshape(-1, 3)
    np.testing.assert_allclose(linear[4], ((mesh.colors[4].numpy() + 0.055) / 1.055) ** 2.4, 1e-4)
    assert whole["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}


def test_a_moving_glb_has_a_target_for_every_frame(tmp_path: Path):
    mesh = a_mesh()
    save_mesh(tmp_path / "a.glb", mesh, motion(mesh))
    whole = document(tmp_path / "a.glb")
    (primitive,) = whole["meshes"][0]["primitives"]
    assert len(primitive["targets"]) == 2
    move = numbers(tmp_path / "a.glb", primitive["targets"][1]["POSITION"]).reshape(-1, 3)
    np.testing.assert_allclose(move, np.tile([0.0, 2.0, 0.0], (8, 1)), atol=1e-5)  # y is up.
    (sampler,) = whole["animations"][0]["samplers"]
    weights = numbers(tmp_path / "a.glb", sampler["output"]).reshape(3, 2)
    np.testing.assert_array_equal(weights, [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_allclose(numbers(tmp_path / "a.glb", sampler["input"]), [0, 0.1, 0.2])


def test_usd_reads_back_frames_and_colours(tmp_path: Path):
    pytest.importorskip("pxr", reason="the extra mesh is not installed")
    from pxr import Usd, UsdGeom

    mesh = a_mesh(texture=True)
    files = save_mesh(tmp_path / "a.usda", mesh, motion(mesh))
    assert [file.name for file in files] == ["a.usda", "a_texture.png"]
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    shape = UsdGeom.Mesh(stage.GetPrimAtPath("/object/surface"))
    points = shape.GetPointsAttr()
    assert points.GetTimeSamples() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(np.array(points.Get(2.0)), motion(mesh).frames[2], atol=1e-5)
    assert stage.GetTimeCodesPerSecond() == 10.0
    corners = np.array(shape.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_array_equal(corners, mesh.faces)
    assert len(shape.GetDisplayColorPrimvar().Get()) == 8
    save_mesh(tmp_path / "b.usdc", a_mesh())  # Binary, and still.
    still = Usd.Stage.Open(str(tmp_path / "b.usdc"))
    assert len(UsdGeom.Mesh(still.GetPrimAtPath("/object/surface")).GetPointsAttr().Get()) == 8


def test_a_texture_stays_the_right_way_up(tmp_path: Path):
    mesh = a_mesh(texture=True)
    assert mesh.texture is not None
    files = save_mesh(tmp_path / "a.obj", mesh)
    assert {file.name for file in files} == {"a.obj", "a.mtl", "a_texture.png"}
    found = trimesh.load(tmp_path / "a.obj", process=False)
    np.testing.assert_allclose(found.visual.uv, mesh.texture.coordinates, atol=1e-6)
    picture = np.asarray(found.visual.material.image.convert("RGB"))
    assert tuple(picture[0, 0]) == (255, 0, 0)
    assert picture.shape == (4, 8, 3)
    save_mesh(tmp_path / "a.glb", mesh)
    other = trimesh.load(tmp_path / "a.glb", process=False).to_geometry()
    np.testing.assert_allclose(other.visual.uv, mesh.texture.coordinates, atol=1e-6)
    texture = np.asarray(other.visual.material.baseColorTexture.convert("RGB"))
    assert tuple(texture[0, 0]) == (255, 0, 0)


def test_other_formats_get_a_file_for_each_frame(tmp_path: Path):
    mesh = a_mesh()
    files = save_mesh(tmp_path / "a.ply", mesh, motion(mesh))
    assert [file.name for file in files] == ["a_000.ply", "a_001.ply", "a_002.ply"]
    last = trimesh.load(files[2], process=False)
    np.testing.assert_allclose(last.vertices, motion(mesh).frames[2], atol=1e-5)


def test_what_cannot_be_written_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match="ends in"):
        save_mesh(tmp_path / "a.stl", a_mesh())
    with pytest.raises(InputError, match="existing folder"):
        save_mesh(tmp_path / "no" / "a.obj", a_mesh())
    monkeypatch.setitem(__import__("sys").modules, "pxr", None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[mesh\]"):
        save_mesh(tmp_path / "a.usd", a_mesh())
    assert list(tmp_path.iterdir()) == []

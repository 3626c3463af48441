"""The add-on in Blender itself: what is posed there arrives in pcore as Blender shows it."""

import importlib.util
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from bundle_run import ball_bundle

from pcore.asset.saving import load
from pcore.capture.load import load_cameras
from pcore.data.meshes import read_mesh
from pcore.editing.animation import load_animation
from pcore.editing.regions import Setting

BPY = os.environ.get("PCORE_BPY") or (sys.executable if importlib.util.find_spec("bpy") else None)
SOURCE = Path(__file__).parents[2] / "blender" / "pcore_bridge"

pytestmark = [
    pytest.mark.bpy,
    pytest.mark.skipif(
        BPY is None, reason="no Blender: set PCORE_BPY to a Python that imports bpy"
    ),
]


def in_blender(*words: str) -> str:
    outcome = subprocess.run([BPY, *words], capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    return outcome.stdout


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = ball_bundle(tmp_path_factory.mktemp("bridge"))
    assert "done" in in_blender(str(Path(__file__).with_name("in_blender.py")), str(folder))
    return folder


def moved(bundle: Path, name: str, frame: int) -> torch.Tensor:
    asset = load(bundle.parent / "ball")
    return asset.pose(bundle / f"{name}.json", time=(frame - 1) / 24).points


def test_displacement_is_exact(bundle: Path):
    size = json.loads((bundle / "bundle.json").read_text())["size"]
    seen = np.load(bundle / "seen_points.npy")
    for shape, frame in zip(seen, (1, 3, 5), strict=True):
        found = moved(bundle, "points", frame).double().numpy()
        assert np.abs(found - shape).max() < 1e-6 * size


def test_anchors_go_where_the_empties_are_at_every_frame(bundle: Path):
    size = json.loads((bundle / "bundle.json").read_text())["size"]
    seen = json.loads((bundle / "seen.json").read_text())
    points, animation = load(bundle.parent / "ball").points, load_animation(bundle / "drag.json")
    handles = json.loads((bundle / "drag.json").read_text())["edits"][0]["handles"]
    near = torch.tensor([handle["near"] for handle in handles])
    index = torch.cdist(near.double(), points.double()).argmin(dim=1)
    assert any(np.allclose(handle["near"], seen["pinned"]) for handle in handles)
    first = int((near - torch.tensor(seen["anchors"][0])).norm(dim=1).argmin())
    for frame, place in enumerate(seen["anchors"]):
        script, wanted = animation.at(frame / 24), torch.tensor(place)
        edit = script.edits[0]
        handle = [*edit.placed(edit.rig(Setting(points=points, rest=points))).values()][first]
        assert float((handle.place - wanted).norm()) < 1e-4 * size
        # A point goes with 8 anchors, so the one at a turned handle is beside it by a little.
        there = script.bind(points)(points)[index[first]]
        assert float((there - wanted).norm()) < 1e-3 * size
    keys = handles[first]["to"]["keyframes"]
    assert 2 < len(keys) < 21


@pytest.mark.parametrize(("mode", "role"), [("cage", "cage"), ("mesh", "proxy")])
def test_meshes_take_the_points_along(bundle: Path, mode: str, role: str):
    size = json.loads((bundle / "bundle.json").read_text())["size"]
    points = load(bundle.parent / "ball").points.double()
    found = moved(bundle, mode, 5).double()
    expected = points.clone()
    expected[:, 0] += 0.1 * points[:, 2] ** 2
    assert float((found - expected).norm(dim=1).max()) < 0.01 * size
    last = sorted(bundle.glob(f"{mode}_*.ply"))[-1]
    vertices = read_mesh(last).vertices.numpy()
    seen = np.load(bundle / f"seen_{mode}.npy")[-1]
    assert np.abs(vertices - seen).max() < 1e-6 * size
    assert len(read_mesh(bundle / f"{role}.ply").vertices) == len(vertices)


def test_a_camera_comes_back_as_it_went(bundle: Path):
    (_, went), *_ = load_cameras(bundle / "cameras.json")
    ((_, came),) = load_cameras(bundle / "path.json")
    corners = torch.cartesian_prod(*[torch.tensor([-0.8, 0.8])] * 3)
    for first, second in zip(went.project(corners), came.project(corners), strict=True):
        assert torch.allclose(first, second.to(first.dtype), atol=2e-3)


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("negative", "its scale is negative or 0"),
        ("sheared", "it is sheared"),
        ("still", "has not moved"),
        ("own file", "is a file of the bundle itself"),
        ("topology", "changes its topology"),
        ("edited", "were edited themselves"),
        ("program", "no such program"),
        ("far", "put it on the object"),
        ("taken", "is at this very place already"),
        ("cage there", "the cage is there"),
        ("lattice there", "a lattice bends it already"),
        ("no anchors", "at least two selected anchors"),
        ("no frames", "got none"),
        ("gap", "the first is frame_001.png"),
    ],
)
def test_what_cannot_come_back_is_refused(bundle: Path, what: str, reason: str):
    assert reason in json.loads((bundle / "seen.json").read_text())[what]


def test_handles_and_pins_go_on_the_point_at_the_cursor(bundle: Path):
    seen = json.loads((bundle / "seen.json").read_text())
    assert seen["held"] == ["anchor 005"]
    near, to = seen["handle"]
    handles = json.loads((bundle / "handle.json").read_text())["edits"][0]["handles"]
    assert len(handles) == 2
    (mine,) = [one for one in handles if np.allclose(one["near"], near)]
    assert np.allclose(mine["to"], to, atol=1e-6)
    points = load(bundle.parent / "ball").points
    assert any(np.array_equal(np.float32(near), point) for point in points.numpy())


def test_a_lattice_bends_the_cage_and_so_the_points(bundle: Path):
    size = json.loads((bundle / "bundle.json").read_text())["size"]
    vertices = read_mesh(bundle / "lattice_0001.ply").vertices.numpy()
    assert np.abs(vertices - np.load(bundle / "seen_lattice.npy")).max() < 1e-6 * size
    asset = load(bundle.parent / "ball")
    moved = asset.pose(bundle / "lattice.json").points - asset.points
    high = asset.points[:, 2] > 0.5 * asset.points[:, 2].max()
    assert float(moved[high, 0].min()) > 0.01 * size


def test_bones_carry_anchors_and_bend_the_proxy(bundle: Path):
    seen = json.loads((bundle / "seen.json").read_text())
    size = json.loads((bundle / "bundle.json").read_text())["size"]
    assert len(seen["bones"]) == 2
    assert seen["rest"] < 1e-5 * size
    assert seen["moved"] > 0.05 * size
    near, to = (np.array(one) for one in seen["carried"])
    assert np.linalg.norm(to - near) > 0.05 * size
    handles = json.loads((bundle / "bones.json").read_text())["edits"][0]["handles"]
    (mine,) = [one for one in handles if np.allclose(one["near"], near)]
    assert np.allclose(mine["to"], to, atol=1e-5)
    assert "rotation" in mine
    mesh = read_mesh(bundle / "bent_0001.ply").vertices - read_mesh(bundle / "proxy.ply").vertices
    assert float(mesh.norm(dim=1).max()) > 0.05 * size


def test_pictures_come_back_behind_on_a_plane_and_in_the_compositor(bundle: Path):
    seen = json.loads((bundle / "seen.json").read_text())
    corners = np.array(sorted(seen["corners"]))
    assert np.allclose(corners, [[0, 0], [0, 1], [1, 0], [1, 1]], atol=1e-4)
    assert seen["sequence"] == [3, "SEQUENCE", "STRAIGHT"]
    linked, ends, transparent = seen["composited"]
    assert linked == ["CompositorNodeImage", "CompositorNodeRLayers"]
    assert ends
    assert transparent


def test_the_extension_builds_and_is_valid(tmp_path: Path):
    find = "import bpy, os; print(bpy.utils.system_resource('SCRIPTS'), flush=True); os._exit(0)"
    scripts = in_blender("-c", find).strip().splitlines()[-1]
    tool = str(Path(scripts) / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py")
    archive = tmp_path / "pcore_bridge-1.0.0.zip"
    in_blender(
        tool, "build", f"--source-dir={SOURCE}", f"--output-filepath={archive}", "--valid-tags="
    )
    in_blender(tool, "validate", "--valid-tags=", str(archive))
    names = zipfile.ZipFile(archive).namelist()
    assert any(name.endswith("blender_manifest.toml") for name in names)
    assert not any("__pycache__" in name for name in names)

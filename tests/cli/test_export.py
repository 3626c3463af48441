"""`pcore export` of both kinds of object, and what it refuses."""

import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
import tyro
from PIL import Image
from rich.console import Console
from toys import toy_cameras, write_cameras, write_run, write_scene

from gaussian_ball import ball_run
from pcore.asset import meshing, splats_of_points
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import load
from pcore.capture.colmap_model import read_model
from pcore.capture.load import load_cameras, load_scene, load_state
from pcore.cli.export import ExportCommand, export
from pcore.data.splat_formats import read_splats
from pcore.errors import DependencyError, EditError, InputError

pytest.importorskip("skimage", reason="the extra mesh is not installed")

TWIST = {"type": "twist", "axis": "z", "angle_deg": {"keyframes": [[0, 0], [1, 60]]}}
RISE = {"type": "rigid", "translation": {"keyframes": [[0, [0, 0, 0]], [4, [0, 0, 0.5]]]}}
MOVE = {"type": "rigid", "translation": [0.0, 0.0, 2.0]}


@pytest.fixture(autouse=True)
def _few_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(meshing, "_VIEWS", 16)
    monkeypatch.setattr(splats_of_points, "_VIEWS", 6)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("export")
    ball_run(root / "ball")
    (root / "twist.json").write_text(json.dumps({"version": 2, "edits": [TWIST]}))
    (root / "move.json").write_text(json.dumps({"version": 2, "edits": [MOVE]}))
    (root / "rise.json").write_text(json.dumps({"version": 2, "edits": [RISE]}))
    return root


def run(folder: Path, to: str, name: str, **options) -> Path:
    options.setdefault("run_folder", folder / "ball")
    command = ExportCommand(to=to, output=folder / name, threads=1, device="cpu", **options)
    export(command, Console(quiet=True))
    return folder / name


def test_parse_as_command_lines():
    words = ["run", "--to", "glb", "-o", "a.glb", "--frames", "5", "--edit", "e.json"]
    words += ["--box", "-1", "-1", "-1", "1", "1", "1", "--watertight"]
    command = tyro.cli(ExportCommand, args=words)
    assert (command.to, command.frames, command.watertight) == ("glb", 5, True)
    assert command.box == (-1, -1, -1, 1, 1, 1)


def test_points_have_colours_normals_and_confidence(folder: Path):
    at_rest = trimesh.load(run(folder, "ply", "points.ply"))
    raw = at_rest.metadata["_ply_raw"]["vertex"]["data"]
    normals = np.stack([raw[name].reshape(-1) for name in ("nx", "ny", "nz")], axis=1)
    outward = at_rest.vertices / 0.8
    assert float((normals * outward).sum(axis=1).mean()) > 0.97
    assert 0.5 < float(raw["confidence"].mean()) <= 1
    # Painted by its normal, and harmonics of degree 0 say the same.
    expected = (0.5 + 0.28209479 * 1.5 * outward).clip(0, 1)
    assert float(np.abs(at_rest.colors[:, :3] / 255 - expected).mean()) < 0.05
    moved = trimesh.load(run(folder, "ply", "moved.ply", edit=folder / "move.json"))
    np.testing.assert_allclose(moved.vertices, at_rest.vertices + np.array([0, 0, 2]), atol=1e-5)


def test_meshes_at_rest_edited_and_moving(folder: Path):
    body = trimesh.load(run(folder, "mesh", "ball.ply", resolution=40, watertight=True))
    radii = np.linalg.norm(body.vertices, axis=1)
    assert abs(float(radii.mean()) - 0.8) < 0.04
    assert body.is_watertight
    assert body.volume > 0
    moved = trimesh.load(
        run(folder, "obj", "moved.obj", resolution=40, edit=folder / "move.json"), process=False
    )
    assert float(moved.vertices[:, 2].mean()) == pytest.approx(2.0, abs=0.02)
    run(folder, "glb", "moving.glb", resolution=24, edit=folder / "twist.json", frames=3)
    content = (folder / "moving.glb").read_bytes()
    assert content.count(b'"targets":[{"POSITION"') == 1


def test_frames_of_other_files(folder: Path):
    run(folder, "splats", "s.ply", edit=folder / "twist.json", frames=2)
    first, last = (read_splats(folder / f"s_00{k}.ply").gaussians for k in (0, 1))
    own = load(folder / "ball").content
    assert isinstance(own, GaussianContent)
    torch.testing.assert_close(first.means.float(), own.gaussians.means)
    assert float((last.means - first.means).norm(dim=1).max()) > 0.1


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("s.ply", "which `pcore import gaussians` reads from a comment of the file: --variance"),
        ("s.splat", "which `pcore import gaussians` must be told: --variance"),
        ("s.glb", "does not hold (`pcore import gaussians` reads .ply, .splat): --variance"),
    ],
)
def test_what_becomes_of_the_screen_filter_is_said(folder: Path, name: str, note: str):
    told = io.StringIO()
    command = ExportCommand(
        run_folder=folder / "ball", to="splats", output=folder / name, threads=1, device="cpu"
    )
    export(command, Console(file=told))
    assert note in told.getvalue()


def test_depth_is_that_of_the_ball(folder: Path):
    pytest.importorskip("OpenEXR", reason="the extra mesh is not installed")
    import OpenEXR

    cameras = write_cameras(folder / "cameras.json", toy_cameras(2, size=24), w=24, h=24)
    out = run(folder, "depth", "depth", cameras=cameras)
    about = json.loads((out / "depth.json").read_text())
    from PIL import Image

    whole = np.asarray(Image.open(out / "r_0_depth.png")) * about["step"]
    assert whole[12, 12] == pytest.approx(3.2, abs=0.1)
    assert whole[0, 0] == 0
    with OpenEXR.File(str(out / "r_0_depth.exr")) as file:
        real = file.channels()["Y"].pixels
    np.testing.assert_allclose(real[12, 12], whole[12, 12], atol=about["step"])
    assert np.isinf(real[0, 0])
    with pytest.raises(InputError, match="holds files already"):
        run(folder, "depth", "depth", cameras=cameras)
    run(folder, "depth", "depth", cameras=cameras, overwrite=True, no_exr=True)


def test_pictures_train_again(folder: Path):
    out = run(folder, "nerfstudio", "set", orbit=6, size=(32, 32), edit=folder / "move.json")
    scene = load_scene(out)
    views = [view for split in scene.splits for view in scene.split(split)]
    assert len(views) == 6
    assert views[0].has_alpha
    column, row, _ = views[0].camera.project(torch.tensor([[0.0, 0.0, 2.0]]))
    assert float(views[0].alpha()[int(row), int(column)]) > 0.9
    assert scene.sparse is not None


def test_cameras_for_colmap(folder: Path):
    out = run(folder, "cameras", "cams", orbit=3)
    assert len((out / "colmap/sparse/0/cameras.txt").read_text().splitlines()) == 1 + 3
    for name, _ in load_cameras(out / "transforms.json"):
        (out / "images").mkdir(exist_ok=True)
        Image.new("RGB", (32, 32)).save(out / "images" / f"{name}.png")
    scenes = [load_scene(out), load_scene(out / "colmap/sparse/0")]
    assert [scene.layout for scene in scenes] == ["transforms.json", "COLMAP"]
    for first, second in zip(*(scene.split("train") for scene in scenes), strict=True):
        apart = first.camera.world_from_camera - second.camera.world_from_camera
        assert float(apart.abs().max()) < 1e-5


def test_frames_of_pictures_are_states_in_time(folder: Path):
    options = {"orbit": 4, "size": (24, 24), "edit": folder / "rise.json", "frames": 3}
    out = run(folder, "nerfstudio", "moving", **options)
    scene = load_scene(out)
    assert scene.states == ("t2", "t4")
    assert [len(scene.split(split)) for split in ("train", "test")] == [3, 1]
    states = [scene, *(load_state(out, name) for name in scene.states)]
    for state, height in zip(states, (0.0, 0.25, 0.5), strict=True):
        view = state.split("test")[0]
        column, row, _ = view.camera.project(torch.tensor([[0.0, 0.0, height]]))
        rows, columns = (view.alpha() > 0.5).nonzero().T.float() + 0.5
        assert float(rows.mean()) == pytest.approx(float(row), abs=0.5)
        assert float(columns.mean()) == pytest.approx(float(column), abs=0.5)


def test_frames_of_cameras_have_the_points_of_their_time(folder: Path):
    options = {"orbit": 4, "edit": folder / "rise.json", "frames": 3}
    out = run(folder, "cameras", "cameras-of-frames", **options)
    for k, height in enumerate((0.0, 0.25, 0.5)):
        points = read_model(out / f"frame_00{k}" / "colmap" / "sparse" / "0").points
        assert points is not None
        assert float(points.positions[:, 2].mean()) == pytest.approx(height, abs=0.01)
        frames = json.loads((out / f"frame_00{k}" / "transforms.json").read_text())["frames"]
        assert [frame["time"] for frame in frames] == [2.0 * k] * 4


def test_splats_of_points(folder: Path):
    papr = folder / "papr"
    write_run(papr, points=60, surfels=True)
    scene = write_scene(folder / "photos", train=6)
    options = {"run_folder": papr, "steps": 3, "edit": folder / "move.json", "scene": scene}
    moved = read_splats(run(folder, "splats", "papr.ply", **options)).gaussians
    assert 1.2 < float(moved.means[:, 2].mean()) < 2.8
    # Flat along the surfels.
    scales = moved.scales.sort(dim=1).values
    assert float((scales[:, 0] / scales[:, 1]).median()) < 0.4


def test_what_cannot_be_is_refused_before_any_work(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(match: str, to: str, name: str, kind=InputError, **options):
        with pytest.raises(kind, match=match):
            run(folder, to, name, **options)
        assert not (folder / name).exists() or (folder / name).is_dir()

    twist = folder / "twist.json"
    refuse("at least 1", "glb", "x.glb", edit=twist, frames=0)
    refuse("no --edit", "glb", "x.glb", frames=2)
    refuse("--time", "glb", "x.glb", frames=2, edit=twist, time=0.5)
    refuse("has keyframes", "glb", "x.glb", EditError, edit=twist)
    refuse("ends in .glb", "glb", "x.obj")
    refuse("ends in .ply", "ply", "x.obj")
    refuse("existing folder", "obj", "no/x.obj")
    refuse("is a folder", "obj", "ball")
    refuse("lower corner", "obj", "x.obj", box=(1, 0, 0, 0, 1, 1))
    refuse("none in", "obj", "x.obj", box=(50, 50, 50, 51, 51, 51), resolution=20)
    refuse("got both", "cameras", "x", orbit=3, cameras=twist)
    (folder / "fold.json").write_text(
        json.dumps({"version": 2, "edits": [{**TWIST, "type": "bend", "angle_deg": 5000}]})
    )
    refuse("fold", "obj", "x.obj", EditError, edit=folder / "fold.json")
    refuse("--faces: expected a whole number of at least 4, got 0", "obj", "x.obj", faces=0)
    refuse("--texture: expected 16 to 8192 pixels, got 0", "obj", "x.obj", texture=0)
    refuse("a finite time, got nan", "ply", "x.ply", EditError, edit=twist, time=float("nan"))
    for package, to, name in (
        ("skimage.measure", "obj", "x.obj"),
        ("pxr", "usd", "x.usd"),
        ("OpenEXR", "depth", "x"),
        ("xatlas", "obj", "x.obj"),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(__import__("sys").modules, package, None)
            refuse(r"pcore-edit\[mesh\]", to, name, DependencyError, texture=64)


def test_a_folder_that_cannot_be_written(folder: Path):
    if os.geteuid() == 0:
        (folder / "file").write_text("")
        with pytest.raises(InputError, match=r"file is a file: expected a folder"):
            run(folder, "cameras", "file/inside", orbit=2)
        return
    locked = folder / "locked"
    locked.mkdir(mode=0o555)
    with pytest.raises(InputError, match="can be written to"):
        run(folder, "obj", "locked/x.obj", resolution=16)

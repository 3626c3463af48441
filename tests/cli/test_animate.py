"""`pcore animate`: a video and points of an edit that changes over time."""

import json
from pathlib import Path

import av
import numpy as np
import pytest
import trimesh
from PIL import Image
from toys import toy_cameras, write_cameras, write_run, write_scene

import pcore
from pcore.cli.main import main
from pcore.data.points import load_points
from pcore.geometry.orbit import growth, orbit_like


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "ball")
    write_run(tmp_path / "run", scene="../ball", factor=1)
    write_edit({"keyframes": [[0, 0.5], [1, 1.5]]})
    return tmp_path


def write_edit(factor: object) -> None:
    content = {"version": 2, "edits": [{"type": "scale", "factor": factor}]}
    Path("edit.json").write_text(json.dumps(content))


def call(*args: object) -> int:
    words = ["animate", "run", "--edit", "edit.json", "--device", "cpu", *map(str, args)]
    return main(words)


def film(path: str) -> np.ndarray:
    with av.open(path) as container:
        return np.stack([f.to_ndarray(format="rgb24") for f in container.decode(video=0)])


def test_a_video_and_the_points(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert call("--frames", 3, "-o", "out.mp4", "--points", "points") == 0
    frames = film("out.mp4")
    assert frames.shape == (3, 16, 16, 3)
    names = sorted(item.name for item in Path("points").iterdir())
    assert names == ["frame_000.ply", "frame_001.ply", "frame_002.ply"]
    clouds = [load_points(f"points/{name}") for name in names]
    np.testing.assert_allclose(clouds[0] * 3, clouds[2], rtol=1e-5)
    np.testing.assert_allclose(clouds[0] * 2, clouds[1], rtol=1e-5)
    shown = capsys.readouterr().out
    assert "3 files of points in points" in shown
    assert "3 frames in out.mp4" in shown


def test_frames_with_transparency_are_the_pictures_and_so_is_the_film_beside_them(folder: Path):
    assert call("--frames", 2, "--frames-dir", "frames", "--depth", "-o", "both.mp4") == 0
    assert call("--frames", 2, "-o", "alone.mp4") == 0
    assert np.abs(film("both.mp4").astype(int) - film("alone.mp4")).max() <= 2
    names = sorted(item.name for item in Path("frames").iterdir())
    assert names == ["frame_000.npz", "frame_000.png", "frame_001.npz", "frame_001.png"]
    with Image.open("frames/frame_001.png") as picture:
        assert picture.mode == "RGBA"
        rgba = np.asarray(picture, dtype=np.float64) / 255
    raw = np.load("frames/frame_001.npz")
    np.testing.assert_allclose(raw["alpha"], rgba[..., 3], atol=1 / 255)
    assert np.isfinite(raw["depth"][raw["alpha"] > 0.5]).all()
    asset = pcore.load("run")
    session = asset.session("edit.json")
    session.at(1.0)
    background = asset.provenance.background
    shown = rgba[..., :3] * rgba[..., 3:] + (1 - rgba[..., 3:]) * background
    camera = orbit_camera(asset)
    own = asset.render(asset.pose(session), camera, detail=detail(asset, camera)).rgb.numpy()
    # Networks without training have colours beyond black, which a file cannot have.
    proper = (rgba[..., :3] > 0) & (rgba[..., :3] < 1)
    assert proper.any()
    assert np.abs(shown - own)[proper].max() < 2.5 / 255


def orbit_camera(asset: pcore.Asset) -> pcore.Camera:
    """The camera that stands where the film's does: as far as the largest frame needs."""
    scene = asset.scene()
    reach = growth(asset.points, 1.5 * asset.points, scene.center)
    return orbit_like([view.camera for view in scene.split("train")], scene.center, 1, scale=reach)[
        0
    ]


def detail(asset: pcore.Asset, camera: pcore.Camera) -> float | None:
    poses = [asset.pose("edit.json", time=time) for time in (0.0, 1.0)]
    return asset.film_detail(poses, [camera, camera])


def test_points_as_binary_gltf(folder: Path):
    assert call("--frames", 2, "--points", "as_ply") == 0
    assert call("--frames", 2, "--points", "as_glb", "--points-format", "glb") == 0
    names = sorted(item.name for item in Path("as_glb").iterdir())
    assert names == ["frame_000.glb", "frame_001.glb"]
    for name in names:
        (cloud,) = trimesh.load_scene(Path("as_glb") / name).geometry.values()
        wanted = load_points(Path("as_ply") / name.replace("glb", "ply")).numpy()
        np.testing.assert_array_equal(cloud.vertices, wanted[:, [0, 2, 1]] * [1, 1, -1])


def test_the_camera_stands_or_goes_round_or_follows_a_path(folder: Path):
    write_edit(1.0)
    call("--frames", 3, "-o", "still.mp4")
    still = film("still.mp4").astype(int)
    # All frames are the same but for the coding.
    assert np.abs(still - still[0]).max() < 40
    call("--frames", 3, "-o", "orbit.mp4", "--orbit")
    cameras = toy_cameras(2)
    write_cameras(folder / "path.json", cameras, w=20, h=16)
    assert call("--frames", 5, "-o", "path.mp4", "--cameras", "path.json") == 0
    assert film("path.mp4").shape == (5, 16, 20, 3)
    around = film("orbit.mp4").astype(int)
    assert around.shape == (3, 16, 16, 3)
    assert np.abs(around - still)[1:].max() > 40


def test_a_fold_in_some_frame_is_found_before_anything_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    bend = {"type": "bend", "axis": "z", "angle_deg": {"keyframes": [[0, 0], [1, 400]]}}
    Path("edit.json").write_text(json.dumps({"version": 2, "edits": [bend]}))
    assert call("--frames", 3, "-o", "out.mp4", "--points", "points") == 2
    assert "edit.json at time 0.5: edit 1 (bend): singular" in capsys.readouterr().err
    assert not Path("out.mp4").exists()
    assert not Path("points").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "expected -o VIDEO.mp4, --frames-dir or --points FOLDER, got none"),
        (["-o", "out.gif"], "out.gif: expected a video that ends in .mp4"),
        (["-o", "none/out.mp4"], "expected an existing folder to write to, got none"),
        (["-o", "a.mp4", "--orbit", "--cameras", "c.json"], "one of --orbit and --cameras, got bo"),
        (["-o", "a.mp4", "--frames", "0"], "frames: expected a whole number of at least 1"),
        (["--points", "run"], "run holds a run: expected a folder for pictures only"),
    ],
)
def test_bad_options(folder: Path, words: list[str], expected: str, capsys):
    assert call(*words) == 2
    assert expected in capsys.readouterr().err

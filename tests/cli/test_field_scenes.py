"""Scenes, images and cameras as people really have them, through the command line."""

from __future__ import annotations

import codecs
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from toys import CONFIG, toy_cameras, toy_cloud, write_cameras, write_run, write_scene

from pcore.asset.saving import load
from pcore.capture.load import load_scene
from pcore.cli.main import main
from pcore.cli.train_checks import check_shows
from pcore.data.image_files import read_header
from pcore.data.points import save_points
from pcore.errors import TrainingError
from pcore.files.model_file import load_model

TRAIN = "transforms_train.json"


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the scene `ball`, and a run of it that was never trained."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    write_scene(tmp_path / "ball")
    torch.manual_seed(0)
    write_run(tmp_path / "run", scene="../ball")
    return tmp_path


def train(*args: object) -> int:
    words = [
        "train",
        "ball",
        "-o",
        "new",
        "--model",
        "papr",
        "--steps",
        1,
        "--device",
        "cpu",
        "--no-tensorboard",
    ]
    words += [] if "--init" in args else ["--points", 40]
    return main([*map(str, words), *map(str, args)])


def render(*args: object) -> int:
    return main(["render", "run", "-o", "out", "--device", "cpu", *map(str, args)])


def change_frames(world: Path, change: Callable[[int, dict[str, Any]], object], **top: Any) -> None:
    path = world / "ball" / TRAIN
    content = json.loads(path.read_text())
    for number, frame in enumerate(content["frames"]):
        change(number, frame)
    content |= top
    path.write_text(json.dumps({key: value for key, value in content.items() if value is not None}))


def same(number: int, frame: dict[str, Any]) -> None:
    """Leave a frame as it is."""


def each_image(world: Path, change: Callable[[Image.Image], Image.Image], **save: Any) -> None:
    for path in (world / "ball" / "train").iterdir():
        change(Image.open(path)).save(path, **save)


# --- the cases of the issue ---------------------------------------------------------------------


def test_a_zoom_in_a_frame_is_seen(world: Path) -> None:
    cameras = [toy_cameras(1)[0]] * 2
    path = write_cameras(world / "zoom.json", cameras, w=16, h=16)
    content = json.loads(path.read_text())
    content["frames"][1]["camera_angle_x"] = 0.35
    path.write_text(json.dumps(content))
    assert render("--cameras", "zoom.json", "--raw") == 0
    wide, near = (np.load(world / "out" / f"r_{i}.npz")["rgb"] for i in range(2))
    assert not np.array_equal(wide, near)


@pytest.mark.parametrize("model", ["EQUIRECTANGULAR", "ORTHOPHOTO"])
def test_other_projections_are_refused(
    world: Path, capsys: pytest.CaptureFixture[str], model: str
) -> None:
    change_frames(world, same, camera_model=model)
    assert train("--init", "grid") == 2
    expected = f"expected images of a pinhole camera, got camera_model {model}"
    assert expected in capsys.readouterr().err
    assert not (world / "new").exists()


def test_utm_poses_are_refused_with_the_offset(
    world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def move(number: int, frame: dict[str, Any]) -> None:
        for row, offset in enumerate((512_345, 5_412_345, 432)):
            frame["transform_matrix"][row][3] += offset

    change_frames(world, move)
    assert train() == 2
    assert "subtract [512345, 5412345, 434] from the last column of" in capsys.readouterr().err


def test_an_opaque_alpha_trains_as_rgb(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    each_image(world, lambda image: image.convert("RGB").convert("RGBA"))
    assert train() == 0
    told = capsys.readouterr().out
    assert "the alpha of all 12 images holds the whole picture: it is no mask" in told
    assert "images without alpha have no visual hull: points start on a grid" in told
    opaque = load_model(world / "new")
    each_image(world, lambda image: image.convert("RGB"))
    assert train("-o", "rgb") == 0
    plain = load_model(world / "rgb")
    assert torch.equal(opaque.cloud.positions, plain.cloud.positions)


def test_masks_of_mask_path_give_a_hull(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (world / "ball" / "masks").mkdir()
    for path in (world / "ball" / "train").iterdir():
        Image.open(path).getchannel("A").save(world / "ball" / "masks" / path.name)
    each_image(world, lambda image: image.convert("RGB"))

    def name(number: int, frame: dict[str, Any]) -> None:
        frame["mask_path"] = f"masks/r_{number}.png"

    change_frames(world, name)
    assert train() == 0
    assert "no visual hull" not in capsys.readouterr().out
    assert float(load_model(world / "new").cloud.positions.norm(dim=1).max()) < 1.1


def test_a_cloud_elsewhere_is_refused(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = toy_cloud(100).positions
    save_points(world / "far.npy", points + 100)
    assert train("--init", "far.npy") == 2
    told = capsys.readouterr().err
    assert "0 of 100 points lie in what the cameras see; are they in the coordinates of" in told
    assert not (world / "new").exists()
    save_points(world / "unit.npy", 0.33 * points + 0.5)
    assert train("--init", "unit.npy") == 0
    assert "of 100 points lie outside of the masks of views" in capsys.readouterr().out


@pytest.mark.parametrize(("size", "code"), [({"w": 12, "h": 16}, 0), ({}, 2)])
def test_turned_photos_are_not_to_be_resized(
    world: Path, capsys: pytest.CaptureFixture[str], size: dict[str, int], code: int
) -> None:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6

    def turned(image: Image.Image) -> Image.Image:
        upright = image.crop((2, 0, 14, 16))
        return upright.transpose(Image.Transpose.ROTATE_90)

    each_image(world, turned, exif=exif)
    change_frames(world, same, camera_angle_x=2 * np.arctan(np.tan(0.35) * 12 / 16), **size)
    assert train() == code
    told = "".join(capsys.readouterr())
    assert "turned by" in told
    assert "EXIF tag" in told
    assert "resize" not in told


def test_backslashes_are_read_and_told_of(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def back(number: int, frame: dict[str, Any]) -> None:
        frame["file_path"] = f"train\\r_{number}.png"

    change_frames(world, back)
    assert train() == 0
    assert "backslashes are read as slashes, in 12 names" in capsys.readouterr().out


def test_sizes_of_frames_are_those_of_the_pictures(
    world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_cameras(world / "per_frame.json", toy_cameras(2), camera_model="OPENCV")
    content = json.loads(path.read_text())
    del content["camera_angle_x"]
    for number, frame in enumerate(content["frames"]):
        frame |= {"w": 50, "h": 50 - 10 * number, "fl_x": 69.4, "fl_y": 69.4, "cx": 25, "cy": 20}
    path.write_text(json.dumps(content))
    assert render("--cameras", "per_frame.json") == 0
    headers = [read_header(world / "out" / f"r_{i}.png") for i in range(2)]
    sizes = [(header.width, header.height) for header in headers]
    assert sizes == [(50, 50), (50, 40)]
    assert "2 views of 50 x 50 and 50 x 40 pixels" in capsys.readouterr().out


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_marks_at_the_beginning_of_files_are_read(world: Path, encoding: str) -> None:
    path = world / "ball" / TRAIN
    path.write_text(path.read_text(), encoding=encoding)
    assert path.read_bytes().startswith((codecs.BOM_UTF8, codecs.BOM_UTF16))
    assert train() == 0


def test_world_to_camera_matrices_are_refused(
    world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def invert(number: int, frame: dict[str, Any]) -> None:
        frame["transform_matrix"] = np.linalg.inv(frame["transform_matrix"]).tolist()

    change_frames(world, invert)
    assert train() == 2
    told = capsys.readouterr().err
    assert "the viewing axes of all 12 views are parallel" in told
    assert "check that poses are camera-to-world, OpenGL axes. Read as world-to-camera" in told


# --- nothing ends well with empty pictures ------------------------------------------------------


def moved_cameras(offset: float) -> list[Any]:
    cameras = []
    for camera in toy_cameras(3):
        pose = camera.world_from_camera.clone()
        pose[:3, 3] += offset
        cameras.append(camera.moved(pose))
    return cameras


@pytest.mark.parametrize("offset", [1000.0, 5e6])
def test_cameras_that_see_no_point_are_refused_before_work(
    world: Path, capsys: pytest.CaptureFixture[str], offset: float
) -> None:
    write_cameras(world / "away.json", moved_cameras(offset), w=16, h=16)
    assert render("--cameras", "away.json") == 2
    told = capsys.readouterr().err
    assert "away.json: 0 of 40 points lie in what its 3 camera(s) see" in told
    assert not (world / "out").exists()


def test_turned_cameras_are_refused_too(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flip = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))
    cameras = [camera.moved(camera.world_from_camera @ flip) for camera in toy_cameras(3)]
    write_cameras(world / "opencv.json", cameras, w=16, h=16)
    assert render("--cameras", "opencv.json") == 2
    assert "camera-to-world with OpenGL axes?" in capsys.readouterr().err
    words = ["animate", "run", "--edit", "edit.json", "-o", "a.mp4", "--cameras", "opencv.json"]
    (world / "edit.json").write_text(json.dumps({"version": 2, "edits": []}))
    assert main([*words, "--device", "cpu"]) == 2
    assert "0 of " in capsys.readouterr().err


def test_some_empty_pictures_are_told_of(world: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(world / "near", scene="../ball", config=replace(CONFIG, cutoff=0.3))
    cameras = [toy_cameras(1)[0], *moved_cameras(1000.0)[:1]]
    write_cameras(world / "some.json", cameras, w=16, h=16)
    words = ["render", "near", "-o", "out", "--device", "cpu", "--cameras", "some.json"]
    assert main(words) == 0
    assert "nothing is to be seen in 1 of 2 pictures: r_1" in capsys.readouterr().out


def test_a_run_that_shows_nothing_is_an_error(world: Path) -> None:
    scene = load_scene(world / "ball")
    check_shows(load(world / "run"), scene)
    write_run(world / "away", scene="../ball", config=replace(CONFIG, background_score=1e4))
    with pytest.raises(TrainingError, match="the run is saved, but nothing is to be seen in its p"):
        check_shows(load(world / "away"), scene)


# --- notes --------------------------------------------------------------------------------------


def test_unknown_keys_are_told_by_the_verbs_that_read_them(
    world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change_frames(world, same, gain=2)
    write_cameras(world / "cameras.json", toy_cameras(2), w=16, h=16, exposure=1)
    assert render("--cameras", "cameras.json") == 0
    assert "warning: cameras.json: keys that pcore does not know" in capsys.readouterr().out
    assert render("--split", "train", "--overwrite") == 0
    assert "warning: transforms_train.json: keys that pcore" in capsys.readouterr().out
    assert train() == 0
    assert capsys.readouterr().out.count("keys that pcore does not know") == 1

"""Folders of phone scanners, as Polycam and Record3D write them."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image
from scipy.spatial.transform import Rotation

from capture_files import HEIGHT, WIDTH, Shot, shots, write_photos
from pcore.capture.load import load_scene
from pcore.data.image_files import read_header
from pcore.errors import SceneError

LENS = {"fx": 30.0, "fy": 31.0, "cx": 12.5, "cy": 8.25}


def polycam(folder: Path, corrected: bool = True) -> list[Shot]:
    """Times as names, one file per camera; the corrected ones are moved by 0.01."""
    taken = shots(9, "16500{}.jpg")
    for images, cameras, shift in (
        ("images", "cameras", 0.0),
        ("corrected_images", "corrected_cameras", 0.01),
    ):
        if shift and not corrected:
            continue
        write_photos(folder / "keyframes" / images, [one.name for one in taken])
        (folder / "keyframes" / cameras).mkdir()
        for one in taken:
            matrix = one.matrix.copy()
            matrix[0, 3] += shift
            said = {f"t_{i}{j}": matrix[i, j] for i in range(3) for j in range(4)}
            said |= LENS | {"width": WIDTH, "height": HEIGHT, "blur_score": 90.1}
            name = f"{Path(one.name).stem}.json"
            (folder / "keyframes" / cameras / name).write_text(json.dumps(said))
    return taken


def record3d(folder: Path, poses: int = 11) -> list[Shot]:
    """More poses than photos, intrinsics by columns."""
    taken = shots(poses, "{}.jpg")
    write_photos(folder / "EXR_RGBD" / "rgb", [one.name for one in taken[:9]])
    rows = [
        [*Rotation.from_matrix(one.matrix[:3, :3]).as_quat(), *one.matrix[:3, 3]] for one in taken
    ]
    matrix = [LENS["fx"], 0, 0, 0, LENS["fy"], 0, LENS["cx"], LENS["cy"], 1]
    content = {"w": WIDTH, "h": HEIGHT, "K": matrix, "fps": 60, "poses": rows}
    (folder / "EXR_RGBD" / "metadata.json").write_text(json.dumps(content))
    return taken


@pytest.mark.parametrize("corrected", [True, False])
def test_polycam(tmp_path: Path, corrected: bool) -> None:
    taken = polycam(tmp_path / "chair", corrected)
    scene = load_scene(tmp_path / "chair")
    assert scene.layout == "Polycam"
    views = {view.name: view for name in scene.splits for view in scene.split(name)}
    assert len(views) == 9
    camera = views["165003"].camera
    expected = taken[3].matrix.copy()
    expected[0, 3] += 0.01 * corrected
    assert np.allclose(camera.world_from_camera, expected, atol=1e-6)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 12.5, 8.25)
    assert any("without Polycam's corrections" in note for note in scene.notes) == (not corrected)


def test_record3d_with_more_poses_than_photos(tmp_path: Path) -> None:
    taken = record3d(tmp_path / "toy")
    for given in (tmp_path / "toy", tmp_path / "toy" / "EXR_RGBD" / "metadata.json"):
        scene = load_scene(given)
        assert scene.layout == "Record3D"
        assert [one.name for one in scene.skipped] == ["9", "10"]
    views = {view.name: view for name in scene.splits for view in scene.split(name)}
    camera = views["3"].camera
    assert np.allclose(camera.world_from_camera, taken[3].matrix, atol=1e-6)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 12.5, 8.25)


def test_what_a_phone_did_not_write_is_refused(tmp_path: Path) -> None:
    polycam(tmp_path / "chair")
    camera = next((tmp_path / "chair" / "keyframes" / "corrected_cameras").glob("*.json"))
    camera.write_text('{"t_00": 1}')
    with pytest.raises(SceneError, match=r"expected a camera of Polycam.*export it again"):
        load_scene(tmp_path / "chair")
    record3d(tmp_path / "toy")
    metadata = tmp_path / "toy" / "EXR_RGBD" / "metadata.json"
    metadata.write_text(json.dumps(json.loads(metadata.read_text()) | {"poses": [[1, 2]]}))
    with pytest.raises(SceneError, match="expected the metadata of Record3D"):
        load_scene(tmp_path / "toy")


def test_heic_without_its_plug_in_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcore.data.image_files.importlib.util.find_spec", lambda _: None)
    (tmp_path / "a.heic").write_bytes(b"\x00\x00\x00\x18ftypheic" + bytes(64))
    with pytest.raises(SceneError, match="pip install pillow-heif"):
        read_header(tmp_path / "a.heic")


def test_heic_photos_are_upright_and_keep_their_alpha(tmp_path: Path) -> None:
    """Its decoder turns them as their tag says; `exif_transpose` must not turn them again."""
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.register_heif_opener()
    frames: list[dict[str, object]] = []
    for number, shot in enumerate(shots(6)):
        upright = Image.new("RGBA" if number else "RGB", (32, 48), (200, 30, 30))
        upright.paste((20, 20, 220), (0, 0, 32, 24))
        if number:
            upright.putalpha(Image.new("L", (32, 48), 255))
            upright.paste((0, 0, 0, 0), (0, 40, 32, 48))
        tag = (1, 6, 8)[number % 3]
        stored = {
            1: upright,
            6: upright.transpose(Image.Transpose.ROTATE_90),
            8: upright.transpose(Image.Transpose.ROTATE_270),
        }[tag]
        exif = Image.Exif()
        exif[ExifTags.Base.Orientation] = tag
        name = f"IMG_{number}.HEIC"
        stored.save(tmp_path / name, format="HEIF", exif=exif.tobytes(), quality=-1)
        frames.append({"file_path": name, "transform_matrix": shot.matrix.tolist()})
    content = {"fl_x": 40, "fl_y": 40, "cx": 16, "cy": 24, "w": 32, "h": 48, "frames": frames}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = load_scene(tmp_path)
    assert scene.skipped == ()
    views = [*scene.split("train"), *scene.split("test")]
    assert len(views) == 6
    for view in views:
        rgba = view.rgba()
        assert rgba.shape == (48, 32, 4)
        assert rgba[4:20, :, 2].mean() > 0.75 > 0.2 > rgba[4:20, :, 0].mean()
        assert rgba[28:36, :, 0].mean() > 0.7
        faint = view.name != "IMG_0"
        assert (float(rgba[44:, :, 3].mean()) < 0.1) == faint

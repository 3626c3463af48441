"""Captures that cannot be read whole: a clear error, or a listed skip."""

import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture_files import (
    HEIGHT,
    WIDTH,
    shots,
    write_camera_list,
    write_colmap,
    write_idr,
    write_llff,
    write_model,
    write_ngp,
    write_nsvf,
    write_photos,
)
from pcore.capture.load import load_scene
from pcore.errors import SceneError


def reason(path: Path) -> str:
    """Why the one photo that is skipped is not used."""
    scene = load_scene(path)
    assert len(scene.skipped) == 1
    return f"{scene.skipped[0].name}: {scene.skipped[0].reason}"


def test_no_images(tmp_path: Path) -> None:
    write_model(tmp_path / "sparse" / "0", shots())
    with pytest.raises(SceneError, match=r"names 10 photos, of which none is in .*img_0\.png"):
        load_scene(tmp_path)


def test_one_image(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    for path in sorted((tmp_path / "images").iterdir())[1:]:
        path.unlink()
    with pytest.raises(SceneError, match=r"at least 2 photos with poses, got 1.*9 of 10 .*no file"):
        load_scene(tmp_path)


def test_a_name_twice(tmp_path: Path) -> None:
    photos = shots()
    photos[4].name = photos[2].name
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    write_model(tmp_path / "sparse" / "0", photos)
    assert reason(tmp_path) == "img_2.png: named twice; the first is used"


@pytest.mark.parametrize("text", [False, True])
def test_lenses_that_are_not_read(text: bool, tmp_path: Path) -> None:
    camera = ("FOV", WIDTH, HEIGHT, [30.0, 30.0, 12.0, 8.0, 0.9])
    photos = shots()
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    write_model(tmp_path / "sparse" / "0", photos, {1: camera}, text=text)
    with pytest.raises(SceneError, match=r"camera model FOV is not read; read are SIMPLE_PINHOLE"):
        load_scene(tmp_path)


def test_fisheyes_of_transforms(tmp_path: Path) -> None:
    write_ngp(tmp_path, camera_model="OPENCV_FISHEYE", k1=0.1)
    with pytest.raises(SceneError, match="fisheye lens"):
        load_scene(tmp_path)


def test_photos_of_another_shape(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    write_photos(tmp_path / "images", ["img_5.png"], size=(16, 24))
    assert reason(tmp_path).startswith("img_5.png: 16 x 24 pixels, and its camera is for 24 x 16")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.97])
def test_truncated_models(name: str, share: float, tmp_path: Path) -> None:
    write_colmap(tmp_path)
    path = tmp_path / "sparse" / "0" / name
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(SceneError, match=f"{name}: expected a whole model"):
        load_scene(tmp_path)


def test_models_with_absurd_counts(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    path = tmp_path / "sparse" / "0" / "images.bin"
    path.write_bytes(struct.pack("<Q", 2**60) + path.read_bytes()[8:])
    with pytest.raises(SceneError, match="truncated or damaged"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_damaged_text_models(name: str, tmp_path: Path) -> None:
    write_colmap(tmp_path, text=True)
    (tmp_path / "sparse" / "0" / f"{name}.txt").write_text("1 2 three\n")
    with pytest.raises(
        SceneError, match="expected a text model of COLMAP, got the line '1 2 three'"
    ):
        load_scene(tmp_path)


def test_empty_models(tmp_path: Path) -> None:
    write_photos(tmp_path / "images", ["a.png"])
    write_model(tmp_path / "sparse" / "0", [])
    with pytest.raises(SceneError, match=r"images\.bin: expected registered images"):
        load_scene(tmp_path)


def test_models_without_cameras(tmp_path: Path) -> None:
    write_colmap(tmp_path, text=True)
    (tmp_path / "sparse" / "0" / "cameras.txt").write_text("# CAMERA_ID\n")
    with pytest.raises(SceneError, match=r"cameras\.txt: expected cameras, got none"):
        load_scene(tmp_path)


def test_models_without_points(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    (tmp_path / "sparse" / "0" / "points3D.bin").unlink()
    scene = load_scene(tmp_path)
    assert scene.sparse is None
    assert any("0 is a model without points (points3D is missing or" in n for n in scene.notes)


def test_poses_that_are_none(tmp_path: Path) -> None:
    write_colmap(tmp_path, text=True)
    path = tmp_path / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines()
    lines[7] = "16 nan 0 0 0 0 0 4 1 img_3.png"
    path.write_text("\n".join(lines))
    assert reason(tmp_path) == "img_3.png: a pose with NaN or infinity"


@pytest.mark.parametrize("rows", [[3], [0, 1, 2, 3]])
def test_matrices_that_are_none(rows: list[int], tmp_path: Path) -> None:
    """Trackers that lose sight of the room write a whole matrix of NaN."""
    write_ngp(tmp_path)
    content = json.loads((tmp_path / "transforms.json").read_text())
    for row in rows:
        content["frames"][3]["transform_matrix"][row] = [float("nan")] * 4
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert reason(tmp_path) == "images/img_3.png: a pose with NaN or infinity"


def test_masks_of_another_size(tmp_path: Path) -> None:
    write_idr(tmp_path)
    write_photos(tmp_path / "mask", ["002.png"], size=(8, 8), mode="L")
    view = load_scene(tmp_path).split("train")[1]
    with pytest.raises(SceneError, match=r"mask .*002\.png: expected 24 x 16 pixels"):
        view.rgba()


def test_masks_that_are_missing(tmp_path: Path) -> None:
    write_idr(tmp_path)
    (tmp_path / "mask" / "004.png").unlink()
    with pytest.raises(SceneError, match="expected a mask for each of 9 photos, got 8"):
        load_scene(tmp_path)
    write_ngp(tmp_path / "ngp", frames={"mask_path": "masks/none.png"})
    with pytest.raises(SceneError, match=r"no mask at masks/none\.png"):
        load_scene(tmp_path / "ngp")


def test_pages_that_were_saved_as_photos(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    (tmp_path / "images" / "img_2.png").write_text("<!DOCTYPE html><html>404</html>")
    assert reason(tmp_path).startswith("img_2.png: expected an image such as PNG, got a file of")


@pytest.mark.parametrize("ending", ["jpg", "png", "webp", "tif", "avif"])
def test_photos_that_were_cut_off(ending: str, tmp_path: Path) -> None:
    photos = shots(names=f"img_{{}}.{ending}")
    write_photos(tmp_path / "images", [shot.name for shot in photos], size=(96, 64))
    write_model(tmp_path / "sparse" / "0", photos)
    assert load_scene(tmp_path).skipped == ()
    path = tmp_path / "images" / f"img_2.{ending}"
    content = path.read_bytes()
    path.write_bytes(content[: 2 * len(content) // 3])
    assert reason(tmp_path).startswith(f"img_2.{ending}: ")
    assert not reason(tmp_path).startswith(f"img_2.{ending}: image")


def test_photos_that_something_was_appended_to(tmp_path: Path) -> None:
    photos = shots(names="img_{}.jpg")
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    write_model(tmp_path / "sparse" / "0", photos)
    path = tmp_path / "images" / "img_2.jpg"
    path.write_bytes(path.read_bytes() + b"a film of the moment" * 500)
    assert load_scene(tmp_path).skipped == ()


def test_pictures_with_wrong_checksums(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    path = tmp_path / "images" / "img_2.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    assert "cut off or damaged" in reason(tmp_path)


def test_lenses_of_nan(tmp_path: Path) -> None:
    write_ngp(tmp_path)
    path = tmp_path / "transforms.json"
    content = json.loads(path.read_text())
    content["frames"][2]["k1"] = float("nan")
    path.write_text(json.dumps(content))
    assert reason(tmp_path).endswith("a lens with NaN or infinity")
    content["frames"][2] |= {"k1": 0.0, "fl_x": -30}
    path.write_text(json.dumps(content))
    with pytest.raises(SceneError, match=r"frame 2 .*: camera: expected positive focal lengths"):
        load_scene(tmp_path)


def test_lenses_that_show_nothing(tmp_path: Path) -> None:
    write_ngp(tmp_path, k1=1e30)
    with pytest.raises(SceneError, match=r"got 0.*its lens \(k1 1e\+30, .* another lens model"):
        load_scene(tmp_path)


def test_spheres_of_idr_without_size(tmp_path: Path) -> None:
    write_idr(tmp_path)
    path = tmp_path / "cameras_sphere.npz"
    with np.load(path) as archive:
        content = dict(archive)
    np.savez(path, **{**content, "scale_mat_0": np.zeros((4, 4))})
    with pytest.raises(SceneError, match=r"the unit sphere .* a radius of 0 around"):
        load_scene(tmp_path)


@pytest.mark.parametrize("layout", ["colmap", "nsvf", "cameras", "ngp"])
def test_text_with_a_byte_order_mark(layout: str, tmp_path: Path) -> None:
    if layout == "colmap":
        write_colmap(tmp_path, text=True)
    else:
        {"nsvf": write_nsvf, "cameras": write_camera_list, "ngp": write_ngp}[layout](tmp_path)
    before = load_scene(tmp_path)
    for path in (*tmp_path.rglob("*.txt"), *tmp_path.rglob("*.json")):
        path.write_text(path.read_text(), encoding="utf-8-sig")
    after = load_scene(tmp_path)
    assert after.layout == before.layout
    assert len(after.split("train")) == len(before.split("train"))


def test_a_link_that_leads_out_is_not_advised(tmp_path: Path) -> None:
    write_ngp(tmp_path / "scene")
    content = json.loads((tmp_path / "scene" / "transforms.json").read_text())
    photo = tmp_path / "scene" / content["frames"][2]["file_path"]
    photo.rename(tmp_path / "elsewhere.png").touch()
    photo.symlink_to(tmp_path / "elsewhere.png")
    with pytest.raises(SceneError, match="leaves the scene's folder") as caught:
        load_scene(tmp_path / "scene")
    assert "A file of that name is there" not in str(caught.value)


@pytest.mark.parametrize("factor", [1, 4])
def test_pictures_of_which_nothing_can_be_measured(factor: int, tmp_path: Path) -> None:
    write_ngp(tmp_path)
    content = json.loads((tmp_path / "transforms.json").read_text())
    name = content["frames"][2]["file_path"]
    for key in ("w", "h"):
        content.pop(key, None)
    size = (2 * factor, 2 * factor)
    Image.new("RGB", size).save(tmp_path / name)
    content["frames"][2] |= {"w": size[0], "h": size[1]}
    for frame in content["frames"][:2] + content["frames"][3:]:
        frame |= {"w": WIDTH, "h": HEIGHT}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = load_scene(tmp_path, factor=factor)
    assert [(one.name, "too small for a photo" in one.reason) for one in scene.skipped] == [
        (name, True)
    ]


def test_picture_bombs(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    Image.new("1", (14_000, 14_000)).save(tmp_path / "images" / "img_2.png")
    assert "more pixels than any camera takes" in reason(tmp_path)


def test_links_that_lead_out(tmp_path: Path) -> None:
    write_colmap(tmp_path / "scene")
    secret = tmp_path / "secret.png"
    (tmp_path / "scene" / "images" / "img_2.png").rename(secret)
    (tmp_path / "scene" / "images" / "img_2.png").symlink_to(secret)
    with pytest.raises(SceneError, match="leaves the scene's folder"):
        load_scene(tmp_path / "scene")


def test_masks_that_lead_out(tmp_path: Path) -> None:
    write_idr(tmp_path / "scene")
    secret = tmp_path / "secret.png"
    (tmp_path / "scene" / "mask" / "002.png").rename(secret)
    (tmp_path / "scene" / "mask" / "002.png").symlink_to(secret)
    with pytest.raises(SceneError, match="leads out of the scene's folder"):
        load_scene(tmp_path / "scene")


@pytest.mark.parametrize("link", ["sparse", "sparse/0/images.bin", "transforms.json"])
def test_models_that_lead_out(tmp_path: Path, link: str) -> None:
    write_ngp(tmp_path / "scene") if link == "transforms.json" else write_colmap(tmp_path / "scene")
    (tmp_path / "scene" / link).rename(tmp_path / "secret")
    (tmp_path / "scene" / link).symlink_to(tmp_path / "secret")
    with pytest.raises(SceneError, match="leads out of the scene's folder"):
        load_scene(tmp_path / "scene")


def test_links_in_a_circle(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    photo = tmp_path / "images" / "img_2.png"
    photo.unlink()
    photo.symlink_to(photo)
    with pytest.raises(SceneError, match="leads in a circle"):
        load_scene(tmp_path)


def test_lists_of_splits_that_lead_out(tmp_path: Path) -> None:
    write_colmap(tmp_path / "scene")
    (tmp_path / "secret").write_text("img_1.png\n")
    (tmp_path / "scene" / "train_list.txt").symlink_to(tmp_path / "secret")
    with pytest.raises(SceneError, match="leads out of the scene's folder"):
        load_scene(tmp_path / "scene")


def test_names_that_lead_out(tmp_path: Path) -> None:
    photos = shots()
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    photos[3].name = "../../../etc/passwd"
    write_model(tmp_path / "sparse" / "0", photos)
    with pytest.raises(SceneError, match="leaves the scene's folder"):
        load_scene(tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="permissions are others there")
def test_read_only_folders(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    for path in (*tmp_path.rglob("*"), tmp_path):
        path.chmod(0o555 if path.is_dir() else 0o444)
    try:
        assert len(load_scene(tmp_path).split("train")) == 8
    finally:
        for path in (tmp_path, *tmp_path.rglob("*")):
            path.chmod(0o755)


class Pickled:
    """Leaves a trace when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (os.mkdir, ("unpickled",))


@pytest.mark.parametrize("layout", ["idr", "llff"])
def test_pickles_are_never_read(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    odd = np.array([Pickled()], dtype=object)
    if layout == "idr":
        write_idr(tmp_path)
        np.savez(tmp_path / "cameras_sphere.npz", world_mat_0=odd, allow_pickle=True)
    else:
        write_llff(tmp_path)
        np.save(tmp_path / "poses_bounds.npy", odd, allow_pickle=True)
    with pytest.raises(SceneError, match="pickles are never read"):
        load_scene(tmp_path)
    assert not (tmp_path / "unpickled").exists()


def test_other_numbers_of_photos_than_of_poses(tmp_path: Path) -> None:
    write_llff(tmp_path)
    (tmp_path / "images" / "IMG_3.JPG").unlink()
    with pytest.raises(SceneError, match="a photo for each of its 9 poses, got 8"):
        load_scene(tmp_path)
    write_idr(tmp_path / "idr")
    (tmp_path / "idr" / "image" / "000003.png").unlink()
    with pytest.raises(SceneError, match="a photo for each of its 9 cameras, got 8"):
        load_scene(tmp_path / "idr")


def test_damaged_archives(tmp_path: Path) -> None:
    write_idr(tmp_path)
    path = tmp_path / "cameras_sphere.npz"
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(SceneError, match="damaged"):
        load_scene(tmp_path)


def test_text_in_numbers(tmp_path: Path) -> None:
    write_nsvf(tmp_path)
    (tmp_path / "bbox.txt").write_text("left right")
    with pytest.raises(SceneError, match=r"bbox\.txt: expected 6 numbers"):
        load_scene(tmp_path)
    (tmp_path / "bbox.txt").unlink()
    (tmp_path / "intrinsics.txt").write_text("thirty")
    with pytest.raises(SceneError, match="expected intrinsics as NSVF"):
        load_scene(tmp_path)


def test_camera_lists_of_other_content(tmp_path: Path) -> None:
    write_camera_list(tmp_path)
    path = tmp_path / "cameras.json"
    entries = json.loads(path.read_text())
    del entries[2]["fx"]
    path.write_text(json.dumps(entries))
    with pytest.raises(SceneError, match="expected the cameras of 3D Gaussian splatting"):
        load_scene(tmp_path)


@pytest.mark.parametrize("box", ["all", [[0, 0, 0]], [[0, 0, 0], [1, 1, -1]], [[0, 0, 0]] * 2])
def test_boxes_that_are_none(box: object, tmp_path: Path) -> None:
    write_ngp(tmp_path, aabb=box)
    with pytest.raises(SceneError, match="two corners of a box in 'aabb'"):
        load_scene(tmp_path)


@pytest.mark.parametrize("world", [{"scale": 0}, {"scale": [1]}, {"offset": [1, 2]}])
def test_a_world_of_instant_ngp_that_is_none(world: dict[str, object], tmp_path: Path) -> None:
    write_ngp(tmp_path, render_aabb=[[0, 0, 0], [1, 1, 1]], **world)
    with pytest.raises(SceneError, match=r"two corners of a box in 'render_aabb'.*mend it"):
        load_scene(tmp_path)


def test_all_views_from_one_direction(tmp_path: Path) -> None:
    photos = shots()
    for index, shot in enumerate(photos):
        shot.matrix[:3, :3] = np.eye(3)
        shot.matrix[:3, 3] = index, 0, 0
    write_photos(tmp_path / "images", [shot.name for shot in photos])
    write_model(tmp_path / "sparse" / "0", photos)
    with pytest.raises(SceneError, match=r"viewing axes of its 8 view.* are parallel"):
        _ = load_scene(tmp_path).center


def test_files_that_choose_nothing(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("")
    with pytest.raises(SceneError, match="expected a folder, got a file"):
        load_scene(tmp_path / "notes.txt")
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).write_text("")
    with pytest.raises(SceneError, match="holds 2 videos; give the path of one"):
        load_scene(tmp_path)


def test_pictures_of_nsvf_without_a_pose(tmp_path: Path) -> None:
    write_nsvf(tmp_path)
    (tmp_path / "pose" / "0_0001.txt").unlink()
    write_photos(tmp_path / "rgb", ["0_0000.jpg"])
    assert {(one.name, one.reason) for one in load_scene(tmp_path).skipped} == {
        ("0_0001.png", "no pose of its own"),
        ("0_0000.png", "no pose of its own"),
    }

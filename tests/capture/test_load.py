import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.capture.load import find_states, load_cameras, load_scene, load_state
from pcore.errors import InputError, SceneError
from scene_files import ANGLE_X, change, change_frame, pose, write_split


def test_splits_cameras_and_downscaling(scene: Path) -> None:
    loaded = load_scene(scene, factor=4)
    assert loaded.name == "toy"
    assert [len(loaded.split(s)) for s in loaded.splits] == [3, 2]
    view = loaded.split("train")[2]
    assert view.rgba().shape == (2, 3, 4)
    assert (view.camera.width, view.camera.height) == (3, 2)
    assert view.camera.fx == pytest.approx(1.5 / math.tan(ANGLE_X / 2))
    assert torch.allclose(view.camera.world_from_camera, torch.tensor(pose(4.0, -0.2)))


def test_file_path_with_extension_and_training_only(tmp_path: Path) -> None:
    path = write_split(tmp_path, "train", mode="RGB")
    change_frame(path, 0, file_path="train/r_0.png")
    loaded = load_scene(tmp_path)
    assert loaded.splits == ("train",)
    view = loaded.split("train")[0]
    assert view.name == "r_0"
    assert not view.has_alpha
    assert view.alpha().min() == 1.0


def test_repeated_stems_get_different_names(scene: Path) -> None:
    path = scene / "transforms_train.json"
    change_frame(path, 1, file_path="test/r_0")
    assert [v.name for v in load_scene(scene).split("train")] == ["r_0_0000", "r_0_0001", "r_2"]


def test_pair_of_states(tmp_path: Path) -> None:
    write_split(tmp_path / "start", "train")
    write_split(tmp_path / "end", "train", count=4)
    write_split(tmp_path / "end", "test", count=2)
    loaded = load_scene(tmp_path)
    assert loaded.root.name == "start"
    assert loaded.name == tmp_path.name
    assert loaded.states == ("end",)
    assert len(loaded.split("train")) == 3
    end = load_state(tmp_path, "end")
    assert [len(end.split(s)) for s in end.splits] == [4, 2]


def test_deformed_states_have_their_own_field_of_view(scene: Path) -> None:
    path = write_split(scene / "scale2x", "test", count=2)
    change(path, camera_angle_x=1.2)
    write_split(scene / "bend60", "test")
    assert load_scene(scene).states == find_states(scene) == ("bend60", "scale2x")
    state = load_state(scene, "scale2x", factor=2)
    assert state.splits == ("test",)
    assert state.split("test")[0].camera.fx == pytest.approx(3.0 / math.tan(0.6))
    with pytest.raises(SceneError, match="no state 'twist'; it has bend60, scale2x"):
        load_state(scene, "twist")
    with pytest.raises(SceneError, match=r"no state '\.\./toy'"):
        load_state(scene, "../toy")


def test_unknown_format_says_what_was_tried(tmp_path: Path) -> None:
    write_split(tmp_path / "start", "train")
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path)
    message = str(caught.value)
    assert "NeRF-Synthetic (transforms_train.json)" in message
    assert "PAPR in Motion (start/transforms_train.json and end/transforms_train.json)" in message


def test_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="no such folder; check the path"):
        load_scene(tmp_path / "none")
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match="expected a folder, got a file"):
        load_scene(tmp_path / "file")


def test_json_that_does_not_parse(scene: Path) -> None:
    path = scene / "transforms_train.json"
    path.write_text(path.read_text()[:200])
    with pytest.raises(SceneError, match=r"transforms_train\.json: expected JSON.*cut off"):
        load_scene(scene)


def test_missing_angle(scene: Path) -> None:
    change(scene / "transforms_train.json", camera_angle_x=None)
    with pytest.raises(SceneError, match=r"train\.json: 'camera_angle_x' is missing; add it"):
        load_scene(scene)


@pytest.mark.parametrize("angle", [0.0, 4.0, float("nan")])
def test_impossible_angle(scene: Path, angle: float) -> None:
    change(scene / "transforms_train.json", camera_angle_x=angle)
    with pytest.raises(SceneError, match=r"frame 0 .*field of view between 0 and pi"):
        load_scene(scene)


def test_no_frames(scene: Path) -> None:
    change(scene / "transforms_train.json", frames=[])
    with pytest.raises(SceneError, match="'frames': expected a list of at least 1"):
        load_scene(scene)


def test_top_level_list(scene: Path) -> None:
    (scene / "transforms_train.json").write_text("[1, 2]")
    with pytest.raises(SceneError, match=r"train\.json: 'top level': expected keys with values"):
        load_scene(scene)


def test_frame_without_matrix(scene: Path) -> None:
    change_frame(scene / "transforms_train.json", 1, transform_matrix=None)
    with pytest.raises(SceneError) as caught:
        load_scene(scene)
    assert "transforms_train.json, frame 1 (./train/r_1): 'transform_matrix' is missing" in str(
        caught.value
    )


def test_matrix_of_another_shape(scene: Path) -> None:
    change_frame(scene / "transforms_train.json", 1, transform_matrix=pose(0.0)[:3])
    with pytest.raises(SceneError, match=r"frame 1 .*has 3 rows, .* nerfstudio"):
        load_scene(scene)


def test_matrix_with_text(scene: Path) -> None:
    """Numbers as text are numbers, as elsewhere in the file; other text is none."""
    before = load_scene(scene).split("train")[2].camera.world_from_camera
    matrix = before.tolist()
    matrix[3] = ["0", "0", 0, "1"]
    matrix[0] = [str(x) for x in matrix[0]]
    change_frame(scene / "transforms_train.json", 2, transform_matrix=matrix)
    assert torch.equal(load_scene(scene).split("train")[2].camera.world_from_camera, before)
    matrix[3][3] = "one"
    change_frame(scene / "transforms_train.json", 2, transform_matrix=matrix)
    with pytest.raises(SceneError, match=r"frame 2 .*transform_matrix.3.3.*a number, got 'one'"):
        load_scene(scene)


def test_nan_pose(scene: Path) -> None:
    matrix = pose(0.0)
    matrix[0][3] = float("nan")
    change_frame(scene / "transforms_train.json", 2, transform_matrix=matrix)
    with pytest.raises(SceneError, match=r"frame 2 \(./train/r_2\): expected finite.*got NaN"):
        load_scene(scene)


def test_pose_that_is_not_rigid(scene: Path) -> None:
    matrix = (np.array(pose(0.0)) * [[1.1], [1], [1], [1]]).tolist()
    change_frame(scene / "transforms_test.json", 1, transform_matrix=matrix)
    with pytest.raises(SceneError, match=r"transforms_test.json, frame 1 .*expected a rigid"):
        load_scene(scene).split("test")


def test_mirrored_pose(scene: Path) -> None:
    matrix = (np.array(pose(0.0)) * [1, -1, 1, 1]).tolist()
    change_frame(scene / "transforms_test.json", 1, transform_matrix=matrix)
    with pytest.raises(SceneError, match=r"frame 1 .*right-handed rotation, got a mirrored one"):
        load_scene(scene).split("test")


def test_transposed_pose(scene: Path) -> None:
    matrix = np.array(pose(1.0)).T.tolist()
    change_frame(scene / "transforms_train.json", 0, transform_matrix=matrix)
    with pytest.raises(SceneError, match=r"last row .* to be 0 0 0 1.*transposed\?"):
        load_scene(scene)


def test_frame_without_path(scene: Path) -> None:
    change_frame(scene / "transforms_train.json", 0, file_path=None)
    with pytest.raises(SceneError, match="frame 0: 'file_path' is missing; name the frame's image"):
        load_scene(scene)


def test_missing_image_is_found_at_once(scene: Path) -> None:
    (scene / "train" / "r_2.png").unlink()
    with pytest.raises(SceneError, match=r"frame 2 \(./train/r_2\): no image at .*r_2"):
        load_scene(scene)


def test_mixed_image_sizes(scene: Path) -> None:
    Image.new("RGBA", (10, 8)).save(scene / "train" / "r_1.png")
    with pytest.raises(
        SceneError, match=r"frame 1 .*expected an image of 12 x 8 .*first image, got 10 x 8"
    ):
        load_scene(scene)


def test_size_stated_in_the_file(scene: Path) -> None:
    change(scene / "transforms_train.json", w=12, h=8.0)
    assert load_scene(scene).split("train")[0].camera.width == 12
    change(scene / "transforms_train.json", w=24, h=16)
    with pytest.raises(
        SceneError, match=r"24 x 16 pixels like 'w' and 'h' of the file, got 12 x 8"
    ):
        load_scene(scene)
    change(scene / "transforms_train.json", h=None)
    with pytest.raises(SceneError, match="expected both 'w' and 'h' or neither, got one"):
        load_scene(scene)


def test_factor_that_does_not_divide(scene: Path) -> None:
    with pytest.raises(
        InputError, match="12 x 8 images cannot be divided by 3; use one of 1, 2, 4"
    ):
        load_scene(scene, factor=3)


@pytest.mark.parametrize("way", ["dots", "absolute", "link"])
def test_path_that_leaves_the_scene(scene: Path, way: str) -> None:
    outside = scene.parent / "secret.png"
    Image.new("RGBA", (12, 8)).save(outside)
    (scene / "link.png").symlink_to(outside)
    paths = {"dots": "train/../../secret", "absolute": str(outside), "link": "link"}
    change_frame(scene / "transforms_train.json", 0, file_path=paths[way])
    with pytest.raises(SceneError, match=r"frame 0 .*'file_path' leaves the scene's folder"):
        load_scene(scene)


def test_scene_folder_may_itself_be_a_link(scene: Path) -> None:
    link = scene.parent / "link"
    link.symlink_to(scene)
    assert len(load_scene(link).split("train")) == 3


def test_cameras_need_no_images(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_text((scene / "transforms_train.json").read_text())
    change_frame(path, 0, file_path=None)
    change_frame(path, 1, file_path="../../etc/pass wd")
    with pytest.raises(SceneError, match=r"says no image size; add 'w' and 'h' .* or give width"):
        load_cameras(path)
    cameras = load_cameras(path, width=30, height=20)
    assert [name for name, _ in cameras] == ["frame", "pass_wd", "r_2"]
    assert cameras[0][1].fx == pytest.approx(15 / math.tan(ANGLE_X / 2))
    change(path, w=60, h=40)
    assert load_cameras(path)[0][1].width == 60
    assert load_cameras(path, width=30, height=20)[0][1].height == 20
    with pytest.raises(InputError, match="width and height or neither, got 30 x None"):
        load_cameras(path, width=30)


def test_cameras_file_missing(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.json: no such file"):
        load_cameras(tmp_path / "none.json")


@pytest.mark.parametrize("name", ["lego", "chair"])
def test_real_nerf_synthetic(shared_data: Path, name: str) -> None:
    loaded = load_scene(shared_data / "nerf_synthetic" / name, factor=4)
    assert [len(loaded.split(s)) for s in loaded.splits] == [100, 50]
    view = loaded.split("test")[7]
    assert view.rgba().shape == (100, 100, 4)
    assert view.camera.fx == pytest.approx(138.8889, abs=1e-3)
    assert loaded.radius == pytest.approx(1.365, abs=1e-3)
    assert 0.05 < float(view.alpha().mean()) < 0.5


@pytest.mark.parametrize("name", ["spot", "knight", "robot"])
def test_true_surface_projects_into_the_masks(shared_data: Path, name: str) -> None:
    root = shared_data / "deformed" / name
    meshes = np.load(root / "meshes.npz")
    for state in (None, *find_states(root)):
        loaded = load_scene(root) if state is None else load_state(root, state)
        points = torch.from_numpy(meshes[state or "canonical"])
        for view in loaded.split("test")[:3]:
            _assert_inside_mask(view.camera, view.alpha(), points)


def _assert_inside_mask(camera, alpha, points) -> None:
    local = (points - camera.center) @ camera.world_from_camera[:3, :3]
    x = (camera.fx * local[:, 0] / -local[:, 2] + camera.cx).long()
    y = (-camera.fy * local[:, 1] / -local[:, 2] + camera.cy).long()
    assert x.min() >= 0
    assert x.max() < camera.width
    # Points on the silhouette may round to the pixel beside it.
    assert (alpha[y, x] > 0).float().mean() > 0.97
    # And the mask is filled: the projections reach its whole bounding box.
    rows = torch.nonzero(alpha.amax(dim=1) > 0.5)[:, 0]
    assert abs(int(y.min()) - int(rows[0])) <= 3
    assert abs(int(y.max()) - int(rows[-1])) <= 3


# --- lenses -----------------------------------------------------------------------------------


def test_intrinsics_in_pixels_scale_with_the_images(scene: Path) -> None:
    path = scene / "transforms_train.json"
    focal = 6 / math.tan(0.5 * ANGLE_X)
    change(path, fl_x=focal, fl_y=1.1 * focal, cx=5.0, cy=4.5)
    change_frame(path, 1, cx=7.0)
    first, second, _ = (view.camera for view in load_scene(scene, factor=2).split("train"))
    expected = (0.5 * focal, 0.55 * focal, 2.5, 2.25)
    assert (first.fx, first.fy, first.cx, first.cy) == pytest.approx(expected)
    assert (second.fx, second.cx, second.cy) == pytest.approx((0.5 * focal, 3.5, 2.25))


def test_a_focal_length_replaces_the_angle(scene: Path) -> None:
    path = scene / "transforms_train.json"
    change(path, camera_angle_x=None)
    for index in range(3):
        change_frame(path, index, fl_x=20.0 + index)
    cameras = [view.camera for view in load_scene(scene).split("train")]
    assert [(c.fx, c.fy, c.cx) for c in cameras] == [(f, f, 6.0) for f in (20.0, 21.0, 22.0)]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"fl_x": 11.0}, r"images of 12 x 8 pixels expect 'fl_x' [\d.]+, got 11; scale fl_x"),
        ({"fl_x": math.nan}, r"expect 'fl_x' [\d.]+, got nan"),
        ({"fl_y": -3.0}, "expected positive focal lengths"),
        ({"cx": 400.0}, r"inside the image of 12 x 8 pixels, got 400, 4; are they"),
        ({"cy": -1.0}, r"inside the image of 12 x 8 pixels, got 6, -1"),
        ({"w": 12, "h": 8, "cy": -90.0}, r"inside the image of 12 x 8 pixels, got 6, -90"),
        ({"k1": 0.03, "p2": -0.001}, r"pinhole camera, got k1 = 0.03, p2 = -0.001; undistort"),
        ({"is_fisheye": True}, r"got a fisheye lens \(is_fisheye\); undistort"),
        ({"camera_model": "OPENCV_FISHEYE"}, r"got a fisheye lens \(camera_model OPENCV_FISH"),
    ],
)
def test_lenses_that_cannot_be(scene: Path, keys: dict[str, Any], message: str) -> None:
    change(scene / "transforms_train.json", **keys)
    with pytest.raises(SceneError, match=rf"transforms_train\.json.*{message}"):
        load_scene(scene)


def test_a_cut_picture_may_lie_beside_the_axis(scene: Path) -> None:
    change(scene / "transforms_train.json", w=12, h=8, cx=-5.0, cy=14.0)
    camera = load_scene(scene).split("train")[0].camera
    assert (camera.cx, camera.cy) == (-5.0, 14.0)


def test_distortion_of_one_frame(scene: Path) -> None:
    change_frame(scene / "transforms_train.json", 1, k2=0.5)
    with pytest.raises(SceneError, match=r"frame 1 .*got k2 = 0.5"):
        load_scene(scene)


def test_no_distortion_is_a_pinhole(scene: Path) -> None:
    before = load_scene(scene).split("train")[0].camera
    keys = {"k1": 0, "k2": 0.0, "is_fisheye": False, "camera_model": "OPENCV"}
    change(scene / "transforms_train.json", **keys)
    after = load_scene(scene).split("train")[0].camera
    assert (after.fx, after.fy, after.cx) == (before.fx, before.fy, before.cx)


def test_cameras_in_pixels_need_the_size_of_the_image(scene: Path) -> None:
    path = scene / "transforms_train.json"
    change(path, cx=4.0)
    with pytest.raises(SceneError, match=r"in pixels .* of an image size that it does not say"):
        load_cameras(path, width=24, height=24)
    change(path, w=12, h=8)
    _, wide = load_cameras(path, width=24, height=24)[0]
    # The picture is square: the field of view across stays, above and below there is more.
    assert (wide.cx, wide.cy) == (8.0, 12.0)
    assert wide.fx == wide.fy == pytest.approx(12 / math.tan(0.5 * ANGLE_X))


# --- splits are read when they are needed -----------------------------------------------------


@pytest.mark.parametrize("harm", ["missing image", "damaged image", "damaged file"])
def test_training_views_do_not_need_the_test_views(scene: Path, harm: str) -> None:
    if harm == "missing image":
        (scene / "test" / "r_1.png").unlink()
    elif harm == "damaged image":
        (scene / "test" / "r_1.png").write_bytes(b"no image")
    else:
        (scene / "transforms_test.json").write_text("{")
    loaded = load_scene(scene)
    assert loaded.splits == ("train", "test")
    assert len(loaded.split("train")) == 3
    assert loaded.radius > 0
    with pytest.raises(SceneError, match=r"transforms_test\.json|r_1\.png"):
        loaded.split("test")


def test_a_split_is_read_once(scene: Path) -> None:
    loaded = load_scene(scene)
    assert loaded.split("test") is loaded.split("test")
    assert len(loaded.views) == 2


def test_a_name_that_no_system_takes_is_refused(scene: Path) -> None:
    change_frame(scene / "transforms_train.json", 2, file_path="z" * 300)
    with pytest.raises(SceneError, match=r"frame 2 .*: 'file_path' is too long"):
        load_scene(scene)


def test_an_image_of_the_longest_name_has_no_mask_beside(scene: Path) -> None:
    name = "r" * 245
    (scene / "train" / "r_2.png").rename(scene / "train" / f"{name}.png")
    change_frame(scene / "transforms_train.json", 2, file_path=f"train/{name}")
    assert len(load_scene(scene).split("train")) == len({*(scene / "train").iterdir()})

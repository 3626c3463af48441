"""Keys about the camera: used, frame before top; or refused by name; others told once."""

import math
from pathlib import Path
from typing import Any

import pytest

from pcore.capture.load import camera_notes, load_cameras, load_scene
from pcore.errors import SceneError
from pcore.geometry.camera import Camera
from scene_files import ANGLE_X, change, change_frame

FOCAL = 6 / math.tan(0.5 * ANGLE_X)
"""Of images 12 x 8 pixels with `ANGLE_X`."""


def cameras(scene: Path) -> list[Camera]:
    return [view.camera for view in load_scene(scene).split("train")]


def zoomed(angle: float) -> float:
    return 6 / math.tan(0.5 * angle)


# --- used, frame before top (faults/01 and kin) -------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "focal"),
    [
        ({"camera_angle_x": 0.4}, zoomed(0.4)),
        ({"fl_x": 31.0}, 31.0),
        ({"x_fov": 30.0}, zoomed(math.radians(30))),  # instant-ngp's, in degrees
        ({"camera_angle_x": 0.4, "fl_x": zoomed(0.4)}, zoomed(0.4)),  # as ARKit apps write both
        ({"camera_angle_x": 0.4, "camera_angle_y": 2 * math.atan(4 / zoomed(0.4))}, zoomed(0.4)),
        ({"fl_x": 31.0, "fl_y": 31.0, "w": 12, "h": 8, "cx": 6.0, "cy": 4.0}, 31.0),  # NeRFCapture
        ({"fl_x": "31.0", "k1": "0.0", "k2": "0"}, 31.0),  # RealityCapture through nerfstudio
    ],
)
def test_a_lens_of_a_frame_goes_before_that_of_the_file(
    scene: Path, keys: dict[str, Any], focal: float
) -> None:
    change_frame(scene / "transforms_train.json", 1, **keys)
    first, second, third = cameras(scene)
    assert (first.fx, third.fx) == pytest.approx((FOCAL, FOCAL))
    assert (second.fx, second.fy) == pytest.approx((focal, focal))


@pytest.mark.parametrize("key", ["camera_angle_x", "fl_x", "x_fov"])
def test_lenses_in_frames_only(scene: Path, key: str) -> None:
    path = scene / "transforms_train.json"
    change(path, camera_angle_x=None)
    value = {"camera_angle_x": 0.4, "fl_x": zoomed(0.4), "x_fov": math.degrees(0.4)}[key]
    for index in range(3):
        change_frame(path, index, **{key: value})
    assert [camera.fx for camera in cameras(scene)] == pytest.approx([zoomed(0.4)] * 3)
    change_frame(path, 2, **{key: None})
    with pytest.raises(SceneError, match="'camera_angle_x' is missing; add it, or 'fl_x'"):
        load_scene(scene)


def test_only_a_vertical_angle_is_that_of_square_pixels(scene: Path) -> None:
    change(scene / "transforms_train.json", camera_angle_x=None, camera_angle_y=0.5)
    assert [one.fx for one in cameras(scene)] == pytest.approx([4 / math.tan(0.25)] * 3)


def test_sizes_of_frames_make_pictures_of_these_sizes(scene: Path) -> None:
    # faults/20, per_frame.json: no size at the top, all of the lens in the frames.
    path = scene / "transforms_train.json"
    change(path, camera_angle_x=None, camera_model="OPENCV")
    for index in range(3):
        change_frame(path, index, w=50, h=40 + index, fl_x=69.0, fl_y=69.0, cx=25.0, cy=20.0)
    found = [camera for _, camera in load_cameras(path)]
    assert [(one.width, one.height, one.fx) for one in found] == [
        (50, 40, 69.0),
        (50, 41, 69.0),
        (50, 42, 69.0),
    ]
    smaller = load_cameras(path, width=25, height=20)[0][1]
    assert (smaller.width, smaller.fx, smaller.cx) == (25, 34.5, 12.5)
    change_frame(path, 1, h=None)
    with pytest.raises(SceneError, match=r"frame 1 .*expected both 'w' and 'h' or neither"):
        load_cameras(path)


def test_numbers_in_pixels_are_not_taken_to_another_size(scene: Path) -> None:
    path = scene / "transforms_train.json"
    change(path, camera_angle_x=None, fl_x=20.0, w=12, h=8)
    change_frame(path, 1, w=24, h=16)
    with pytest.raises(SceneError, match=r"frame 1 .*is of 24 x 16 pixels, but takes numbers in p"):
        load_cameras(path)
    change_frame(path, 1, fl_x=40.0)
    assert [camera.fx for _, camera in load_cameras(path)] == [20.0, 40.0, 20.0]


# --- contradictions -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        # Blender's camera.angle_y belongs to its sensor of 36 x 24, not to square images.
        ({"camera_angle_y": 0.9}, r"means pixels [\d.]+ times as high as wide; remove 'camera_"),
        ({"x_fov": 55.0}, r"expected 'x_fov' in degrees to be the 'camera_angle_x' of 0.7"),
        ({"fl_y": 16.0, "camera_angle_y": 0.9}, r"expect 'fl_y' [\d.]+, got 16"),
        ({"camera_angle_y": -1.0}, r"expected 'camera_angle_y' between 0 and pi radians, got -1"),
        ({"w": 12.5, "h": 8}, r"'w': expected a whole number, got 12.5"),
        ({"fl_x": "wide"}, r"'fl_x': expected a number, got 'wide'"),
        ({"fl_x": True}, r"'fl_x': .*expected a number, got true"),
    ],
)
def test_lenses_that_contradict_themselves(scene: Path, keys: dict[str, Any], message: str) -> None:
    change(scene / "transforms_train.json", **keys)
    with pytest.raises(SceneError, match=rf"transforms_train\.json.*{message}"):
        load_scene(scene)


# --- refused by name (faults/03 and kin) --------------------------------------------------------

REFUSED = [
    ({"camera_model": "EQUIRECTANGULAR"}, "pinhole camera, got camera_model EQUIRECTANGULAR"),
    ({"camera_model": "ORTHOPHOTO"}, "pinhole camera, got camera_model ORTHOPHOTO"),
    ({"camera_model": "VR180_L"}, "got camera_model VR180_L"),  # nerfstudio's CameraType
    ({"camera_model": "THIN_PRISM_FISHEYE"}, r"got a fisheye lens \(camera_model THIN_PRISM_F"),
    ({"camera_model": "FOV"}, "got camera_model FOV"),  # COLMAP's
    ({"equirectangular": True}, r"got 'equirectangular' \(true\)"),  # instant-ngp's
    ({"latlong": True}, r"got 'latlong' \(true\)"),
    ({"ftheta_p0": 0.1}, r"got 'ftheta_p0' \(0.1\)"),
    ({"rolling_shutter": [0.0, 0.0, 0.01, 0.0]}, r"got 'rolling_shutter'.*while it takes a pic"),
    ({"camera_type": "spherical"}, r"got 'camera_type' \(\"spherical\"\)"),
    ({"k5": 0.01}, r"got 'k5' \(0.01\)"),  # OpenCV's rational model
    ({"b1": 1.5, "b2": -0.2}, r"got 'b1' \(1.5\)"),  # Metashape's affinity and skew
    ({"distortion_params": [0.1, 0, 0, 0]}, "got 'distortion_params'"),
    ({"intrinsic_matrix": [[9, 0, 6], [0, 9, 4], [0, 0, 1]]}, "as 'fl_x', 'fl_y', 'cx' and 'cy'"),
    ({"fx": 20.0}, r"got 'fx' \(20.0\), .*write the focal length in pixels, 'fl_x'"),
    ({"fov": 40.0}, r"got 'fov' \(40.0\), .*'camera_angle_x' \(radians\) or 'x_fov' \(degrees\)"),
    ({"width": 12, "height": 8}, r"got 'width' \(12\), .*the size of the image is 'w' and 'h'"),
    ({"shift_x": 0.1}, "got 'shift_x'.*principal point 'cx', 'cy'"),  # Blender's lens shift
    ({"pixel_aspect_y": 2.0}, r"got 'pixel_aspect_y' \(2.0\)"),
    ({"sensorWidth": 36.0}, r"got 'sensorWidth' \(36.0\)"),
    ({"white_transparent": True}, "got 'white_transparent'.*make that colour transparent"),
    ({"fix_premult": True}, "got 'fix_premult'.*straight alpha"),
    ({"mask_file": "masks/0.png"}, "got 'mask_file'"),
    ({"alpha_path": "alpha/0.png"}, "got 'alpha_path'"),
    ({"crop": {"top": 3}}, "got 'crop'"),
    ({"from_na": True}, "got 'from_na'.*OpenGL axes"),  # NeuS2's
]


@pytest.mark.parametrize("place", ["top", "frame"])
@pytest.mark.parametrize(("keys", "message"), REFUSED, ids=lambda case: str(case)[:40])
def test_what_changes_the_camera_is_refused_by_name(
    scene: Path, keys: dict[str, Any], message: str, place: str
) -> None:
    path = scene / "transforms_train.json"
    if place == "top":
        change(path, **keys)
        where = r"transforms_train\.json: "
    else:
        change_frame(path, 2, **keys)
        where = r"transforms_train\.json, frame 2 \(./train/r_2\): "
    with pytest.raises(SceneError, match=rf"{where}.*{message}"):
        load_scene(scene)


@pytest.mark.parametrize(
    "keys",
    [
        {"camera_model": "PINHOLE"},
        {"camera_model": "SIMPLE_RADIAL", "k1": 0.0},
        {"camera_type": "perspective"},
        {"rolling_shutter": [0.0, 0.0, 0.0, 0.0], "equirectangular": False, "is_fisheye": False},
        {"mask_path": None, "k5": 0, "b1": 0.0, "distortion": []},
        {"pixel_aspect_x": 1.0, "pixel_aspect_y": 1},
        {"white_transparent": False, "shift_x": 0.0},
        # instant-ngp's colmap2nerf.py and nerfstudio's ns-process-data.
        {"aabb_scale": 16, "scale": 0.33, "offset": [0.5, 0.5, 0.5], "up": [0, 0, 1]},
        {"applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]], "applied_scale": 2.0},
        {"orientation_override": "none", "ply_file_path": "sparse_pc.ply"},
        {"integer_depth_scale": 1 / 65535, "depth_width": 256, "depth_height": 192},
    ],
    ids=lambda keys: ",".join(keys),
)
def test_what_changes_nothing_is_harmless(scene: Path, keys: dict[str, Any]) -> None:
    before = cameras(scene)
    change(scene / "transforms_train.json", **keys)
    after = load_scene(scene)
    assert [view.camera.fx for view in after.split("train")] == [one.fx for one in before]
    assert [note for note in after.notes if "depth_" not in note] == []


def test_a_frame_may_bring_what_tools_write_about_images(scene: Path) -> None:
    path = scene / "transforms_train.json"
    for index in range(3):
        change_frame(path, index, sharpness=9.0, colmap_im_id=index, rotation=0.01, timestamp=1.5)
    assert load_scene(scene).notes == ()


# --- told once ----------------------------------------------------------------------------------


def test_unknown_keys_are_told_once(scene: Path) -> None:
    path = scene / "transforms_train.json"
    change(path, gain=2, train_filenames=["r_0.png"])
    change_frame(path, 0, exposure=1.0)
    change_frame(path, 2, exposure=2.0)
    loaded = load_scene(scene)
    (note,) = loaded.notes
    assert note == (
        "transforms_train.json: keys that pcore does not know and does not use: 'gain', "
        "'train_filenames', 'exposure' (2 of 3 frames)"
    )
    change(path, w=12, h=8)
    assert camera_notes(path) == loaded.notes


def test_notes_come_with_the_split_that_they_are_about(scene: Path) -> None:
    change(scene / "transforms_test.json", gain=2)
    loaded = load_scene(scene)
    assert loaded.notes == ()
    loaded.split("test")
    assert len(loaded.notes) == 1

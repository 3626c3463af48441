"""Camera files of other programs: recognised by their shape, named, with what to convert."""

import json
from pathlib import Path
from typing import Any

import pytest

from pcore.capture.load import load_cameras, load_scene
from pcore.errors import SceneError
from scene_files import change_frame, pose

FLAT = [number for row in pose(0.0) for number in row]
SFM_VIEW = {"viewId": "1", "path": "a.jpg"}
FILES: list[tuple[str, Any, str, str]] = [
    # The five of faults/20 (per_frame.json is read, see test_lens_keys.py).
    (
        "nerfstudio's viewer",
        {
            "camera_type": "perspective",
            "render_height": 50,
            "render_width": 50,
            "camera_path": [{"camera_to_world": FLAT, "fov": 39.6, "aspect": 1.0}],
        },
        "a camera path of nerfstudio",
        r"each 'camera_to_world' \(16 numbers, row by row\).*'fov' \(vertical, degrees\) as 'y",
    ),
    (
        "ns-export cameras",
        [{"file_path": "frame_0.png", "transform": pose(0.0)[:3]}],
        "cameras that nerfstudio exported",
        r"the row \[0, 0, 0, 1\] below it",
    ),
    (
        "instant-ngp's camera path",
        {"loop": False, "path": [{"R": [1, 0, 0, 0], "T": [0.5, 0.5, -1], "fov": 50.6}], "time": 1},
        "a camera path of instant-ngp",
        "quaternion x y z w",
    ),
    # Others.
    (
        "3DGS cameras.json",
        [
            {
                "id": 0,
                "img_name": "00001",
                "width": 1959,
                "height": 1090,
                "position": [0.0, 1.0, 2.0],
                "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
                "fy": 1164.6,
                "fx": 1159.5,
            }
        ],
        "the cameras.json of a 3D Gaussian splatting run",
        r"negate the second and third column of its rotation \(OpenCV axes\); 'fx', 'fy' are",
    ),
    (
        "Record3D",
        {"h": 960, "w": 720, "fps": 60, "K": [1, 0, 0, 0, 1, 0, 9, 9, 1], "poses": [[0] * 7]},
        "the metadata of a Record3D recording",
        "ns-process-data record3d",
    ),
    (
        "Polycam",
        {"t_00": 1.0, "t_01": 0.0, "t_23": 4.0, "fx": 700.0, "blur_score": 50.0, "width": 1024},
        "one camera of Polycam's raw data",
        "ns-process-data polycam",
    ),
    (
        "Meshroom",
        {"version": ["1", "0"], "views": [SFM_VIEW], "intrinsics": [], "poses": []},
        "a scene of Meshroom",
        "colmap2nerf.py",
    ),
    (
        "OpenMVG",
        {"sfm_data_version": "0.3", "views": [], "intrinsics": [], "extrinsics": []},
        "a scene of OpenMVG",
        "openMVG2Colmap",
    ),
    (
        "OpenSfM, OpenDroneMap",
        [{"cameras": {}, "shots": {}, "points": {}}],
        "a reconstruction of OpenSfM or OpenDroneMap",
        "ns-process-data odm",
    ),
    (
        "Nerfies",
        {
            "orientation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
            "position": [0, 0, 4],
            "focal_length": 700.0,
            "principal_point": [320, 240],
        },
        "one camera of the Nerfies format",
        "the transpose of 'orientation'",
    ),
    (
        "NeRFactor",
        {"cam_angle_x": 0.69, "cam_transform_mat": "1,0,0,0", "imh": 512, "imw": 512},
        "the metadata of one view of NeRFactor",
        "'cam_angle_x' as 'camera_angle_x'",
    ),
    (
        "Open3D",
        {"class_name": "PinholeCameraTrajectory", "parameters": [{"extrinsic": FLAT}]},
        "a camera trajectory of Open3D",
        "invert every 'extrinsic'",
    ),
    (
        "nerfstudio's world",
        {"transform": pose(0.0)[:3], "scale": 0.3},
        "dataparser_transforms.json, which holds no cameras",
        "the transforms file that nerfstudio was trained on",
    ),
    (
        "pcore's own edits",
        {"version": 2, "edits": []},
        "an edit file of pcore",
        "give it with --edit",
    ),
    ("glTF", {"asset": {"version": "2.0"}, "scenes": [{}]}, "a glTF scene", "NeRF add-on"),
    ("list of frames", [{"transform_matrix": pose(0.0)}], "a bare list of frames", '"frames"'),
    ("list of matrices", [pose(0.0), pose(1.0)], "a bare list of matrices", '"frames"'),
    ("list of c2w", [{"c2w": pose(0.0)}], "a bare list of cameras", "camera-to-world with OpenGL"),
]
TEXTS = [
    ("COLMAP", "# Camera list with one line of data per camera:\n1 PINHOLE 1 1 1 1 0 0\n"),
    ("COLMAP", "# Image list with two lines of data per image:\n"),
    ("Metashape", '<?xml version="1.0"?>\n<document version="2.0.0">\n  <chunk label="c">\n'),
    ("RealityCapture", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1\na.jpg,0,0,0,0,0,0,26,0,0,0"),
    ("Bundler", "# Bundle file v0.3\n1 1\n"),
    ("Git LFS", "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"),
]


@pytest.mark.parametrize(("content", "what", "advice"), [case[1:] for case in FILES])
def test_files_of_other_programs_are_named(
    tmp_path: Path, content: Any, what: str, advice: str
) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(content))
    with pytest.raises(
        SceneError, match=f"cameras.json: expected a transforms file .*{advice}"
    ) as e:
        load_cameras(path, width=8, height=8)
    assert f"got {what}" in str(e.value) or what in str(e.value)


@pytest.mark.parametrize(("program", "text"), TEXTS)
def test_text_of_other_programs_is_named(tmp_path: Path, program: str, text: str) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(text)
    with pytest.raises(SceneError, match=f"expected a transforms file .*got .*{program}"):
        load_cameras(path, width=8, height=8)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"transform_matrix": pose(0.0)[:3]}, r"has 3 rows, .*: add the row \[0, 0, 0, 1\]"),
        ({"transform_matrix": FLAT}, "is one list of 16 numbers; expected 4 rows of 4"),
        ({"transform_matrix": FLAT[:12]}, "is one list of 12 numbers; expected 4 rows of 4"),
        (
            {"transform_matrix": None, "camera_to_world": FLAT},
            "missing, 'camera_to_world' is there",
        ),
        ({"transform_matrix": None, "pose": pose(0.0)}, "missing, 'pose' is there; if that is cam"),
        ({"transform_matrix": None, "extrinsics": pose(0.0)}, "missing, 'extrinsics' is there"),
    ],
)
def test_poses_of_another_shape_are_named(scene: Path, keys: dict[str, Any], message: str) -> None:
    change_frame(scene / "transforms_train.json", 1, **keys)
    with pytest.raises(SceneError, match=rf"frame 1 \(./train/r_1\): .*{message}"):
        load_scene(scene)


@pytest.mark.parametrize("content", [3, "text", None, True, [], {}, [3], {"frames": {}}])
def test_other_json_is_an_error_without_a_guess(tmp_path: Path, content: Any) -> None:
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(content))
    with pytest.raises(SceneError, match=r"cameras.json: '(top level|frames)'") as caught:
        load_cameras(path, width=8, height=8)
    for word in ("None", "True", "dict", "Input should", "tuple"):
        assert word not in str(caught.value)

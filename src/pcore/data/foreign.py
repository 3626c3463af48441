"""Camera files of other programs, recognised by their shape, so that an error can name them.

They are not read: most of their poses are in a world that the other program made for itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, cast


class Foreign(NamedTuple):
    """What a file is instead of a transforms file.

    Attributes:
        what: the file, and the program that writes it.
        advice: what to convert, and how.
    """

    what: str
    advice: str


_OWN_WORLD = "; its poses are in nerfstudio's own world: undo dataparser_transforms.json as well"
_OPENCV = "negate the second and third column of its rotation (OpenCV axes)"

# Keys that an object must have, and what it then is. The first that fits is taken.
_OBJECTS: tuple[tuple[frozenset[str], Foreign], ...] = (
    (
        frozenset({"camera_path"}),
        Foreign(
            "a camera path of nerfstudio's viewer or of its Blender add-on",
            "write each 'camera_to_world' (16 numbers, row by row) as the 4 x 4 "
            "'transform_matrix' of a frame, 'fov' (vertical, degrees) as 'y_fov', and "
            f"'render_width', 'render_height' as 'w', 'h'{_OWN_WORLD}",
        ),
    ),
    (
        frozenset({"path"}),
        Foreign(
            "a camera path of instant-ngp (base_cam.json)",
            "write each 'R' (quaternion x y z w) and 'T' as the 4 x 4 'transform_matrix' of a "
            "frame, after undoing instant-ngp's scale, offset and order of the axes (its "
            "testbed's Python can save the matrices)",
        ),
    ),
    (
        frozenset({"poses", "K"}),
        Foreign(
            "the metadata of a Record3D recording",
            "convert the recording with nerfstudio's `ns-process-data record3d`",
        ),
    ),
    (
        frozenset({"t_00", "t_23"}),
        Foreign(
            "one camera of Polycam's raw data (keyframes/cameras)",
            "convert the folder with nerfstudio's `ns-process-data polycam`",
        ),
    ),
    (
        frozenset({"views", "poses", "intrinsics"}),
        Foreign(
            "a scene of Meshroom (cameras.sfm)",
            "convert it with the script mr2nerf.py, or export to COLMAP and use colmap2nerf.py",
        ),
    ),
    (
        frozenset({"views", "extrinsics", "intrinsics"}),
        Foreign(
            "a scene of OpenMVG (sfm_data.json)",
            "export it to COLMAP (openMVG_main_openMVG2Colmap) and convert that with "
            "instant-ngp's colmap2nerf.py",
        ),
    ),
    (
        frozenset({"orientation", "position", "focal_length"}),
        Foreign(
            "one camera of the Nerfies format",
            "write the transpose of 'orientation' with its second and third column negated, and "
            "'position', as the 'transform_matrix' of a frame; 'focal_length' is 'fl_x'",
        ),
    ),
    (
        frozenset({"cam_transform_mat"}),
        Foreign(
            "the metadata of one view of NeRFactor",
            "write its 16 numbers as the 4 x 4 'transform_matrix' of a frame, 'cam_angle_x' as "
            "'camera_angle_x'",
        ),
    ),
    (
        frozenset({"class_name", "parameters"}),
        Foreign(
            "a camera trajectory of Open3D",
            "invert every 'extrinsic' (world-to-camera, column by column) and "
            f"{_OPENCV}; 'intrinsic_matrix' holds fl_x, fl_y, cx and cy",
        ),
    ),
    (
        frozenset({"class_name", "trajectory"}),
        Foreign(
            "a view of Open3D's window",
            "save the trajectory with poses instead, and convert its matrices",
        ),
    ),
    (
        frozenset({"transform", "scale"}),
        Foreign(
            "nerfstudio's dataparser_transforms.json, which holds no cameras",
            "give the transforms file that nerfstudio was trained on",
        ),
    ),
    (
        frozenset({"edits", "version"}),
        Foreign("an edit file of pcore", "give it with --edit, and a file of cameras here"),
    ),
    (
        frozenset({"asset", "scenes"}),
        Foreign("a glTF scene", "export the cameras with a NeRF add-on (BlenderNeRF)"),
    ),
)

# Keys that the first item of a list must have, and what the list then is.
_ITEMS: tuple[tuple[frozenset[str], Foreign], ...] = (
    (
        frozenset({"position", "rotation"}),
        Foreign(
            "the cameras.json of a 3D Gaussian splatting run",
            "write 'rotation' (camera-to-world; the rows are its rows) and 'position' as the 4 x 4 "
            f"'transform_matrix' of a frame and {_OPENCV}; 'fx', 'fy' are 'fl_x', 'fl_y', and "
            "'width', 'height' are 'w', 'h'",
        ),
    ),
    (
        frozenset({"cameras", "shots"}),
        Foreign(
            "a reconstruction of OpenSfM or OpenDroneMap",
            "convert it with nerfstudio's `ns-process-data odm`",
        ),
    ),
    (
        frozenset({"transform"}),
        Foreign(
            "cameras that nerfstudio exported (ns-export cameras)",
            "write each 'transform' with the row [0, 0, 0, 1] below it as the 'transform_matrix' "
            f"of a frame, beside the lens (fl_x, fl_y, cx, cy, w, h){_OWN_WORLD}",
        ),
    ),
    (
        frozenset({"transform_matrix"}),
        Foreign(
            "a bare list of frames",
            'put it into an object with the lens: {"camera_angle_x": ..., "frames": [...]}',
        ),
    ),
)

_MATRICES = ("transform", "camera_to_world", "c2w", "pose", "cam2world", "matrix", "extrinsics")


def foreign_json(content: object) -> Foreign | None:
    """Say what parsed JSON is when it is not a transforms file but a known other thing."""
    if isinstance(content, list):
        return _foreign_list(cast("list[Any]", content))
    if not isinstance(content, dict) or "frames" in content:
        return None
    keys = set(cast("dict[str, Any]", content))
    return next((what for needed, what in _OBJECTS if needed <= keys), None)


def foreign_text(text: str) -> Foreign | None:
    """Say what text that is not JSON is, when its beginning tells."""
    head = text[:2000].lstrip()
    if head.startswith("# Camera list") or head.startswith("# Image list"):
        return Foreign(
            "a text model of COLMAP", "convert the model with instant-ngp's colmap2nerf.py"
        )
    if head.startswith("<") and "<chunk" in text[:20000]:
        return Foreign(
            "the cameras of Metashape (XML)",
            "convert them with nerfstudio's `ns-process-data metashape`",
        )
    if head.startswith("#name") or head.startswith("#cameras"):
        return Foreign(
            "the registration of RealityCapture (CSV)",
            "convert it with nerfstudio's `ns-process-data realitycapture`",
        )
    if head.startswith("# Bundle file"):
        return Foreign("a Bundler file", "convert it with COLMAP and colmap2nerf.py")
    if head.startswith("version https://git-lfs"):
        return Foreign("a pointer of Git LFS", "fetch the file itself with `git lfs pull`")
    return None


def foreign_matrix(frame: Mapping[str, Any]) -> str | None:
    """Say what is odd about the pose of a frame: another key, another shape; None if nothing is."""
    if "transform_matrix" not in frame:
        there = next((key for key in _MATRICES if key in frame), None)
        if there is None:
            return None
        return (
            f"'transform_matrix' is missing, {there!r} is there; if that is camera-to-world with "
            "OpenGL axes (x right, y up, looking along -z), write it as a 4 x 4 'transform_matrix'"
        )
    matrix: Any = frame["transform_matrix"]
    if not isinstance(matrix, list):
        return None
    rows = cast("list[Any]", matrix)
    if len(rows) == 3 and all(isinstance(row, list) and len(row) == 4 for row in rows):
        return (
            "'transform_matrix' has 3 rows, as in exports of nerfstudio (ns-export cameras) and "
            "code that leaves the last row out; expected 4: add the row [0, 0, 0, 1], and see "
            "that the poses are in the world of the scene"
        )
    if len(rows) in (12, 16) and not any(isinstance(row, list) for row in rows):
        return (
            f"'transform_matrix' is one list of {len(rows)} numbers; expected 4 rows of 4: "
            "[[...], [...], [...], [0, 0, 0, 1]], row by row"
        )
    return None


def _foreign_list(items: list[Any]) -> Foreign | None:
    first = items[0] if items else None
    if isinstance(first, list):
        return Foreign(
            "a bare list of matrices",
            'write {"camera_angle_x": ..., "frames": [{"transform_matrix": [...]}, ...]}',
        )
    if not isinstance(first, dict):
        return None
    keys = set(cast("dict[str, Any]", first))
    known = next((what for needed, what in _ITEMS if needed <= keys), None)
    if known is None and set(_MATRICES) & keys:
        return Foreign(
            "a bare list of cameras",
            'write {"camera_angle_x": ..., "frames": [{"transform_matrix": [...]}, ...]}, '
            "camera-to-world with OpenGL axes",
        )
    return known

"""Keys of transforms files: which are used, which change nothing here, which are refused by name.

A key that names a lens, an image size, the shape of pixels, a projection or a mask and is not used
would mean rays that are wrong without a word, so it is refused. What is neither known to be
harmless nor looks like one of those is told of.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from pcore.errors import SceneError

_USED = """camera_angle_x camera_angle_y x_fov y_fov fl_x fl_y cx cy w h k1 k2 k3 k4 p1 p2
is_fisheye camera_model mask_path"""
USED_AT_TOP = frozenset([*_USED.split(), "frames"])
CLEAR_KEYS = {"white_transparent": 1.0, "black_transparent": 0.0}
"""instant-ngp's: pixels whose three channels are that are background."""
USED_IN_CAPTURES = frozenset(["train_filenames", "val_filenames", "test_filenames", *CLEAR_KEYS])
USED_IN_FRAME = frozenset([*_USED.split(), "file_path", "transform_matrix"])

# The world of other programs: cameras and images mean the same without it.
_WORLD = """aabb aabb_scale render_aabb render_aabb_to_local scale offset up scene_center
scene_radius applied_transform applied_scale orientation_override auto_scale_poses_override
ply_file_path n_extra_learnable_dims"""
# How sharp an image is, when and by what it was taken.
_ORIGIN = """sharpness sharpness_discard_threshold sharpen blur_score time timestamp rotation
colmap_im_id camera_id camera_label frame_id image_id id index name label tool generator exporter
version comment"""
# Depth and normals, which are not learned from.
_DEPTH = """depth_path depth_file_path depth_unit_scale_factor integer_depth_scale
enable_depth_loading enable_ray_loading normal_path normal_file_path near far near_plane far_plane
importance_sampling"""
HARMLESS = frozenset([*_WORLD.split(), *_ORIGIN.split(), *_DEPTH.split()])

_PERSPECTIVE = (
    "convert the images to perspective ones (nerfstudio's ns-process-data does so for panoramas)"
)
_ADVICE = {
    **dict.fromkeys(
        ("fx", "focal", "focal_length"), "write the focal length in pixels, 'fl_x' and 'fl_y'"
    ),
    "fy": "write the focal length in pixels, 'fl_x' and 'fl_y'",
    **dict.fromkeys(
        ("fov", "fov_x", "fovx", "fov_y", "fovy", "cam_angle_x", "angle_x", "camera_angle"),
        "write 'camera_angle_x' (radians) or 'x_fov' (degrees), the angle of the image's width",
    ),
    **dict.fromkeys(
        ("width", "height", "image_size", "img_size"), "the size of the image is 'w' and 'h'"
    ),
    **dict.fromkeys(
        ("intrinsic_matrix", "intrinsics", "K", "camera_matrix", "camera_intrinsics"),
        "write its numbers as 'fl_x', 'fl_y', 'cx' and 'cy', in pixels",
    ),
    **dict.fromkeys(
        ("equirectangular", "latlong", "camera_type", "projection", "projection_type"),
        _PERSPECTIVE,
    ),
    **dict.fromkeys(
        CLEAR_KEYS,
        "make that colour transparent in the images (RGBA), or remove the key",
    ),
    "fix_premult": "write the images with straight alpha, as PNG files have it",
    "rolling_shutter": "a camera that moves while it takes a picture is not modelled",
    "transform_matrix_start": "a camera that moves while it takes a picture is not modelled",
    "transform_matrix_end": "a camera that moves while it takes a picture is not modelled",
    "from_na": "write camera-to-world matrices with OpenGL axes (NeuS2's are turned about x)",
    **dict.fromkeys(("shift_x", "shift_y"), "write the principal point 'cx', 'cy' in pixels"),
}
_CAMERA = """fov fovx fovy fl fx fy cx cy focal lens distortion distorted distort coeffs
coefficients fisheye ftheta projection intrinsic intrinsics sensor aspect principal skew shutter
rolling calibration width height resolution crop ortho orthographic equirectangular latlong panorama
mask masks alpha matte silhouette transparent premult"""
_CAMERA_WORDS = frozenset(_CAMERA.split())
_ELSEWHERE = frozenset({"depth", "normal", "normals", "semantic", "semantics", "points", "ply"})
_COEFFICIENT = re.compile(r"[kpsb]\d+")
_PINHOLE = frozenset(["perspective", "pinhole", "opencv"])


def check_keys(entry: Mapping[str, Any], used: frozenset[str], where: str) -> list[str]:
    """Refuse keys that change the camera and are not used; return those that are not known.

    A value that says "none" (null, false, 0, an empty list, zeros) changes nothing.

    Args:
        entry: the top of a transforms file, or one frame.
        used: keys that are read there.
        where: file and frame, for the message.

    Raises:
        SceneError: names the first such key and its value, and what to write instead.
    """
    unknown: list[str] = []
    for key, value in entry.items():
        if key in used or key in HARMLESS or _says_nothing(key, value):
            continue
        if not _names_camera(key):
            unknown.append(key)
            continue
        advice = _ADVICE.get(key, "remove it if the images do not need it, or convert the images")
        raise SceneError(
            f"{where}: expected no key that changes the camera beside those that are used, got "
            f"{key!r} ({_short(value)}), which is not read; {advice}"
        )
    return unknown


def note_of_unknown(top: Iterable[str], frames: Iterable[str], count: int) -> str | None:
    """One sentence about all keys of a file that are not known; None when there are none.

    Args:
        top: unknown keys at the top.
        frames: unknown keys of all frames, with repetitions.
        count: number of frames.
    """
    parts = [f"'{key}'" for key in sorted(top)]
    for key, number in sorted(Counter(frames).items()):
        parts.append(f"'{key}' ({number} of {count} frames)")
    if not parts:
        return None
    shown = ", ".join(parts[:12]) + f" and {len(parts) - 12} more" * (len(parts) > 12)
    return f"keys that pcore does not know and does not use: {shown}"


def _names_camera(key: str) -> bool:
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", key).lower()
    words = set(re.split(r"[^a-z0-9]+", apart))
    if words & _ELSEWHERE:
        return False
    coefficient = any(_COEFFICIENT.fullmatch(word) for word in words)
    return key in _ADVICE or coefficient or bool(words & _CAMERA_WORDS)


def _says_nothing(key: str, value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return all(_says_nothing(key, item) for item in value)
    if isinstance(value, dict):
        return not value
    if isinstance(value, str):
        return not value.strip() or value.strip().lower() in _PINHOLE
    return value is None or value == 0 or ("aspect" in key and value == 1)


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else text[:37] + "..."

"""The published sets in small: their layouts, with a box that is pictured truly."""

import json
from pathlib import Path

import numpy as np

import capture_files
import tiny_scene
from tiny_scene import CORNERS

TIMES = (0.0, 0.25, 1.0)


def grown(places: np.ndarray, time: float = 1.0) -> np.ndarray:
    """Where time takes the box: it grows to one and a half."""
    return (1 + 0.5 * time) * places


def neural_editor(root: Path) -> Path:
    """A NeRF-Synthetic scene and one of its deformed scenes, with its 40,000 points in order."""
    scene = tiny_scene.write_scene(root / "ns_box", meshes=False, states=False)
    state = scene / "box_data"
    for split, views in (("train", slice(0, 6)), ("test", slice(6, 8))):
        cameras = tiny_scene.orbit(8)[views]
        tiny_scene.write_split(state, split, grown(CORNERS), cameras)
        old, new = state / split, state / f"views_{split}"
        old.rename(new)
        content = (state / f"transforms_{split}.json").read_text()
        (state / f"transforms_{split}.json").unlink()
        (new / "transforms.json").write_text(content.replace(f"./{split}/", f"./{new.name}/"))
    inside = np.random.default_rng(1).uniform(-1, 1, (40_000, 3)) * [0.65, 0.5, 0.4]
    np.save(state / "points_before.npy", inside.astype(np.float32))
    np.save(state / "points_after.npy", grown(inside).astype(np.float32))
    return scene


def pair(root: Path) -> Path:
    """`start` and `end` of PAPR in Motion: the box, and the box that has grown."""
    for side, vertices in (("start", CORNERS), ("end", grown(CORNERS))):
        for split, views in (("train", slice(0, 6)), ("test", slice(6, 8))):
            cameras = tiny_scene.orbit(8)[views]
            tiny_scene.write_split(root / side, split, vertices, cameras)
    return root


def time_sequence(root: Path, *, cameras_each: int | None = None) -> Path:
    """Frames of D-NeRF's form; the first time is learned where it has several cameras.

    Args:
        root: folder to make.
        cameras_each: at each time; None: all of them. D-NeRF's own scenes have one.
    """
    cameras = tiny_scene.orbit(8)
    for split, views in (("train", slice(0, 6)), ("test", slice(6, 8))):
        frames = []
        for number, time in enumerate(TIMES):
            place = root / f"of_{number}"
            tiny_scene.write_split(place, split, grown(CORNERS, time), cameras[views])
            content = json.loads((place / f"transforms_{split}.json").read_text())
            (place / f"transforms_{split}.json").unlink()
            for frame in content["frames"][:cameras_each]:
                path = frame["file_path"].replace("./", f"./of_{number}/")
                frames.append({**frame, "file_path": path, "time": time, "rotation": 0.03})
        path = root / f"transforms_{split}.json"
        path.write_text(json.dumps({"camera_angle_x": tiny_scene.ANGLE, "frames": frames}))
    return root


def dtu(root: Path, scan: str = "scan24") -> Path:
    """A scan of DTU as IDR and NeuS pass it on, with masks."""
    (root / scan).mkdir(parents=True)
    capture_files.write_idr(root / scan, 17)
    return root / scan


def mip_nerf_360(root: Path, name: str = "garden", small: tuple[int, ...] = (4, 8)) -> Path:
    """A scene of Mip-NeRF 360: a model of COLMAP, photos and smaller copies of them."""
    width, height = 2 * capture_files.WIDTH, 2 * capture_files.HEIGHT
    lens = ("SIMPLE_PINHOLE", width, height, [60.0, width / 2, height / 2])
    photos = capture_files.write_colmap(root / name, 17, cameras={1: lens})
    names = [photo.name for photo in photos]
    for factor in (1, *small):
        folder = "images" if factor == 1 else f"images_{factor}"
        capture_files.write_photos(root / name / folder, names, (width // factor, height // factor))
    return root / name

"""Tiny captures in the layouts of real tools, written by code."""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from scene_files import pose

WIDTH, HEIGHT = 24, 16
OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
MODELS = {
    **{"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4},
    **{"OPENCV_FISHEYE": 5, "FOV": 7, "THIN_PRISM_FISHEYE": 10},
}


@dataclass
class Shot:
    """A photo to be written: OpenGL camera-to-world (4, 4) and its camera's number."""

    name: str
    matrix: np.ndarray
    camera: int = 1

    @property
    def camera_from_world(self) -> np.ndarray:
        """OpenCV axes."""
        return np.linalg.inv(self.matrix @ OPENCV)


def shots(count: int = 10, names: str = "img_{}.png") -> list[Shot]:
    return [
        Shot(names.format(i), np.array(pose(2.0 * i, 0.4 - 0.3 * (i % 4)))) for i in range(count)
    ]


def write_photos(
    folder: Path, names: Sequence[str], size: tuple[int, int] = (WIDTH, HEIGHT), mode: str = "RGB"
) -> None:
    """Noise, the same for the same place in the list."""
    for index, name in enumerate(names):
        pixels = np.random.default_rng(index).integers(0, 256, (size[1], size[0], 4), np.uint8)
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).convert(mode).save(path)


def points(count: int = 20) -> np.ndarray:
    return np.random.default_rng(5).normal(size=(count, 3)) * 0.3


def projected(shot: Shot, camera: tuple[str, int, int, list[float]], xyz: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) by COLMAP's formulas."""
    local = xyz @ shot.camera_from_world[:3, :3].T + shot.camera_from_world[:3, 3]
    u, v = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    name, _, _, numbers = camera
    if name in ("PINHOLE", "OPENCV"):
        fx, fy, cx, cy, *k = numbers
    else:
        fx, cx, cy, *k = numbers
        fy = fx
    k1, k2, p1, p2 = [*k, 0, 0, 0, 0][:4]
    r2 = u * u + v * v
    radial = 1 + k1 * r2 + k2 * r2 * r2
    x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    y = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return np.stack([fx * x + cx, fy * y + cy], axis=1)


PLAIN = ("SIMPLE_PINHOLE", WIDTH, HEIGHT, [30.0, 12.0, 8.0])


def write_model(
    folder: Path,
    photos: Sequence[Shot],
    cameras: dict[int, tuple[str, int, int, list[float]]] | None = None,
    *,
    text: bool = False,
    xyz: np.ndarray | None = None,
) -> Path:
    """A model of COLMAP with points that all photos see; image numbers have gaps."""
    cameras = cameras or {1: PLAIN}
    xyz = points() if xyz is None else xyz
    folder.mkdir(parents=True, exist_ok=True)
    write = _write_text if text else _write_binary
    write(folder, photos, cameras, xyz)
    return folder


def _pose_numbers(shot: Shot) -> list[float]:
    matrix = shot.camera_from_world
    x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    return [w, x, y, z, *matrix[:3, 3]]


def _write_binary(folder: Path, photos, cameras, xyz) -> None:
    with (folder / "cameras.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(cameras)))
        for number, (name, width, height, numbers) in cameras.items():
            file.write(struct.pack("<iiQQ", number, MODELS[name], width, height))
            file.write(struct.pack(f"<{len(numbers)}d", *numbers))
    with (folder / "images.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(photos)))
        for index, shot in enumerate(photos):
            file.write(struct.pack("<i7di", 3 * index + 7, *_pose_numbers(shot), shot.camera))
            file.write(shot.name.encode() + b"\0" + struct.pack("<Q", len(xyz) + 1))
            for row, place in enumerate(projected(shot, cameras[shot.camera], xyz)):
                file.write(struct.pack("<ddq", *place, 5 * row + 2))
            file.write(struct.pack("<ddq", 1.0, 1.0, -1))
    with (folder / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(xyz)))
        for row, place in enumerate(xyz):
            file.write(struct.pack("<Q3d3BdQ", 5 * row + 2, *place, 255, 0, 51, 0.5, 1))
            file.write(struct.pack("<ii", 7, row))


def _write_text(folder: Path, photos, cameras, xyz) -> None:
    lines = ["# Camera list"]
    for number, (name, width, height, numbers) in cameras.items():
        lines.append(f"{number} {name} {width} {height} {' '.join(map(repr, numbers))}")
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n")
    lines = ["# Image list"]
    for index, shot in enumerate(photos):
        numbers = " ".join(repr(float(one)) for one in _pose_numbers(shot))
        lines.append(f"{3 * index + 7} {numbers} {shot.camera} {shot.name}")
        places = projected(shot, cameras[shot.camera], xyz)
        seen = [f"{x!r} {y!r} {5 * row + 2}" for row, (x, y) in enumerate(places.tolist())]
        lines.append(" ".join(seen))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = [
        f"{5 * row + 2} {x!r} {y!r} {z!r} 255 0 51 0.5 7 {row}"
        for row, (x, y, z) in enumerate(xyz.tolist())
    ]
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")


def write_colmap(root: Path, count: int = 10, **options: Any) -> list[Shot]:
    photos = shots(count)
    write_photos(root / "images", [shot.name for shot in photos])
    write_model(root / "sparse" / "0", photos, **options)
    return photos


def write_transforms(
    root: Path, photos: Sequence[Shot], *, frames: dict[str, Any] | None = None, **top: Any
) -> Path:
    """A `transforms.json` as instant-ngp writes it; photos are not written."""
    root.mkdir(parents=True, exist_ok=True)
    content = {
        "fl_x": 30.0,
        "fl_y": 30.0,
        "cx": 12.0,
        "cy": 8.0,
        "w": float(WIDTH),
        "h": float(HEIGHT),
        "aabb_scale": 4,
        "frames": [
            {
                "file_path": f"images/{shot.name}",
                "sharpness": 30.0,
                "transform_matrix": shot.matrix.tolist(),
                **(frames or {}),
            }
            for shot in photos
        ],
        **top,
    }
    path = root / "transforms.json"
    path.write_text(json.dumps({key: one for key, one in content.items() if one is not None}))
    return path


def write_ngp(root: Path, count: int = 10, **options: Any) -> list[Shot]:
    photos = shots(count)
    write_photos(root / "images", [shot.name for shot in photos])
    write_transforms(root, photos, **options)
    return photos


def write_idr(root: Path, count: int = 9, *, masks: bool = True) -> list[Shot]:
    """Projections whose pixel centres lie at whole numbers, scaled at random as IDR's are."""
    photos = shots(count, "{:06d}.png")
    write_photos(root / "image", [shot.name for shot in photos])
    if masks:
        write_photos(root / "mask", [f"{i:03d}.png" for i in range(count)], mode="L")
    intrinsics = np.array([[30.0, 1e-5, 11.5], [0, 29.0, 7.5], [0, 0, 1]])
    content: dict[str, np.ndarray] = {}
    for index, shot in enumerate(photos):
        world = np.eye(4)
        world[:3] = (index + 1) * -0.5 * intrinsics @ shot.camera_from_world[:3]
        content[f"world_mat_{index}"] = world.astype(np.float32)
        scale = np.diag([2.0, 2.0, 2.0, 1.0])
        scale[:3, 3] = 0.1, 0.2, 0.3
        content[f"scale_mat_{index}"] = scale.astype(np.float32)
    np.savez(root / "cameras_sphere.npz", **content)
    return photos


def write_llff(root: Path, count: int = 9) -> list[Shot]:
    photos = shots(count, "IMG_{}.JPG")
    write_photos(root / "images", [shot.name for shot in photos])
    rows = []
    for shot in photos:
        right, up, back, at = (shot.matrix[:3, i] for i in range(4))
        block = np.stack([-up, right, back, at, [HEIGHT, WIDTH, 30.0]], axis=1)
        rows.append([*block.ravel(), 1.0, 9.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
    return photos


def write_nsvf(root: Path, count: int = 6) -> list[Shot]:
    photos = shots(count, "{}_img.png")
    for index, shot in enumerate(photos):
        shot.name = f"{(0, 0, 0, 1, 2, 2)[index]}_{index:04d}.png"
    write_photos(root / "rgb", [shot.name for shot in photos])
    (root / "pose").mkdir()
    for shot in photos:
        np.savetxt(root / "pose" / f"{Path(shot.name).stem}.txt", shot.matrix @ OPENCV)
    (root / "intrinsics.txt").write_text("30.0 12.0 8.0 0.\n0. 0. 0.\n0.\n1.\n16 24\n")
    (root / "bbox.txt").write_text("-1 -2 -3 1 2 3 0.4\n")
    return photos


def write_camera_list(root: Path, count: int = 9) -> list[Shot]:
    photos = shots(count)
    write_photos(root / "images", [shot.name for shot in photos])
    entries = [
        {
            "id": index,
            "img_name": Path(shot.name).stem,
            "width": WIDTH,
            "height": HEIGHT,
            "position": shot.matrix[:3, 3].tolist(),
            "rotation": (shot.matrix @ OPENCV)[:3, :3].tolist(),
            "fx": 30.0,
            "fy": 30.0,
        }
        for index, shot in enumerate(photos)
    ]
    (root / "cameras.json").write_text(json.dumps(entries))
    return photos

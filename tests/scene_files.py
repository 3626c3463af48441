"""Tiny scene folders for tests."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ANGLE_X = 0.7


def pose(azimuth: float, height: float = 0.4, radius: float = 4.0) -> list[list[float]]:
    """Camera-to-world matrix on a sphere, looking at the origin."""
    ring = math.sqrt(1.0 - height**2)
    backward = np.array([ring * math.cos(azimuth), ring * math.sin(azimuth), height])
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = right, np.cross(backward, right)
    matrix[:3, 2], matrix[:3, 3] = backward, radius * backward
    return matrix.tolist()


def write_split(
    root: Path, split: str, *, count: int = 3, size: tuple[int, int] = (12, 8), mode: str = "RGBA"
) -> Path:
    """Write images and `transforms_{split}.json`; returns the JSON's path."""
    (root / split).mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(count)
    frames = []
    for i in range(count):
        pixels = rng.integers(0, 256, (size[1], size[0], 4), dtype=np.uint8)
        Image.fromarray(pixels).convert(mode).save(root / split / f"r_{i}.png")
        matrix = pose(2.0 * i, 0.4 - 0.3 * (i % 4))
        frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": matrix, "time": 0.5})
    path = root / f"transforms_{split}.json"
    path.write_text(json.dumps({"camera_angle_x": ANGLE_X, "frames": frames, "tool": "test"}))
    return path


def change(path: Path, **keys: Any) -> None:
    """Set top-level keys of a JSON file; None removes one."""
    content = json.loads(path.read_text())
    content.update(keys)
    path.write_text(json.dumps({k: v for k, v in content.items() if v is not None}))


def change_frame(path: Path, index: int, **keys: Any) -> None:
    """Set keys of one frame; None removes one."""
    content = json.loads(path.read_text())
    frame = content["frames"][index]
    frame.update(keys)
    content["frames"][index] = {k: v for k, v in frame.items() if v is not None}
    path.write_text(json.dumps(content))

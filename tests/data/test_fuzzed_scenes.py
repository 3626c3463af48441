"""Five hundred damaged transforms files: a scene or an error of ours, never anything else."""

import json
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcore.capture.load import load_cameras, load_scene
from pcore.errors import PcoreError
from scene_files import write_split

_KEYS = "fl_x cx w h k1 camera_model camera_angle_x camera_angle_y x_fov mask_path is_fisheye"
KEYS = _KEYS.split()
VALUES: list[Any] = [
    None,
    True,
    -1,
    0,
    1e308,
    -1e-308,
    10**400,
    float("nan"),
    float("inf"),
    "",
    "1",
    "\0",
    "../..",
    "\ud800",
    "ä" * 3000,
    [],
    [[]],
    [0, 0, 0],
    {},
    {"a": []},
]


def places(content: Any) -> list[tuple[Any, Any]]:
    """Every container of a document with every key or index in it."""
    items = content.items() if isinstance(content, dict) else enumerate(content)
    found: list[tuple[Any, Any]] = []
    for key, value in items:
        found.append((content, key))
        if isinstance(value, (dict, list)):
            found += places(value)
    return found


def mutated(text: str, draw: random.Random) -> bytes:
    """Change values, add keys, swap and drop entries, or damage the bytes."""
    content = json.loads(text)
    for _ in range(draw.randint(1, 3)):
        container, key = draw.choice(places(content))
        kind = draw.randrange(5)
        if kind == 0:
            container[key] = draw.choice(VALUES)
        elif kind == 1:
            frame = draw.choice([content, *(f for f in content["frames"] if isinstance(f, dict))])
            frame[draw.choice(KEYS)] = draw.choice(VALUES)
            return json.dumps(content).encode()
        elif kind == 2:
            del container[key]
            return json.dumps(content).encode()
        elif kind == 3:
            other, place = draw.choice(places(json.loads(text)))
            container[key] = other[place]
        else:
            data = bytearray(json.dumps(content).encode(draw.choice(["utf-8", "utf-16"])))
            del data[draw.randrange(len(data)) :]
            return bytes(data)
        if not isinstance(content.get("frames"), list):
            break
    return json.dumps(content).encode()


def test_damaged_files_end_in_a_scene_or_an_error_of_ours(tmp_path: Path) -> None:
    path = write_split(tmp_path, "train")
    text, draw = path.read_text(), random.Random(17)
    read = 0
    for _ in range(500):
        path.write_bytes(mutated(text, draw))
        for reader in (
            lambda: [view.rgba() for view in load_scene(tmp_path).split("train")],
            lambda: load_cameras(path, width=5, height=4),
        ):
            with suppress(PcoreError):
                reader()
                read += 1
    assert 0 < read < 500

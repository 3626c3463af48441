import json
from pathlib import Path

import pytest
import torch

from pcore.data.world_transform import load_world_transform
from pcore.errors import InputError


def write(folder: Path, content: dict) -> Path:
    (folder / "t.json").write_text(json.dumps(content))
    return folder / "t.json"


def test_points_go_where_nerfstudio_puts_them(tmp_path: Path):
    rows = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]]
    moved = load_world_transform(write(tmp_path, {"transform": rows, "scale": 0.5}))
    point = torch.tensor([[1.0, 2, 3]], dtype=torch.float64)
    assert moved(point).tolist() == [[-0.5, 1.5, 3.0]]
    assert moved.inverse()(moved(point)).tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "'transform' is missing"),
        ({"transform": [[1, 0, 0, 0]]}, "transform"),
        ({"transform": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "transform"),
        ({"transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0]]}, "determinant"),
        ({"transform": [[1, 0, 0, 0]] * 3}, "determinant"),
        ({"transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 0}, "scale"),
    ],
)
def test_what_is_no_map_is_refused(tmp_path: Path, content: dict, message: str):
    with pytest.raises(InputError, match=message):
        load_world_transform(write(tmp_path, content))

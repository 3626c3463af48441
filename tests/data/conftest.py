"""A small scene folder."""

from pathlib import Path

import pytest

from scene_files import write_split


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A NeRF-Synthetic scene: 3 training and 2 test views of 12 x 8 pixels."""
    root = tmp_path / "toy"
    write_split(root, "train")
    write_split(root, "test", count=2)
    return root

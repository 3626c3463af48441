"""Fixtures of the training tests."""

from pathlib import Path

import pytest

from pcore.capture.load import load_scene
from pcore.data.scene import Scene
from tiny_scene import write_scene


@pytest.fixture(scope="session")
def box_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photos of a box: 6 training and 2 test views of 24 x 24 pixels."""
    return write_scene(tmp_path_factory.mktemp("scenes") / "box", meshes=False, states=False)


@pytest.fixture
def box(box_folder: Path) -> Scene:
    """The same, freshly loaded."""
    return load_scene(box_folder)

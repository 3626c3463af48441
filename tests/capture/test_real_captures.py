"""The captures of `shared/data`, read without an option."""

from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from pcore.capture.load import load_scene
from pcore.data.scene import Scene

Read = Callable[..., Scene]


@pytest.fixture
def read(shared_data: Path) -> Read:
    """Reads a set by its name."""

    def opened(name: str, factor: int = 1) -> Scene:
        if not (shared_data / name).is_dir():
            pytest.skip(f"the capture {name} is not on this machine")
        return load_scene(shared_data / name, factor=factor)

    return opened


def test_fox(read: Read) -> None:
    scene = read("captures/fox", factor=12)
    assert (len(scene.split("train")), len(scene.split("test"))) == (43, 7)
    assert len(scene.skipped) == 17
    view = scene.split("train")[0]
    assert (view.camera.width, view.camera.height) == (90, 160)
    valid = view.valid()
    assert valid is not None
    assert 0.95 < float(valid.float().mean()) < 1.0


def test_the_points_of_beer_are_where_its_photos_show_them(read: Read) -> None:
    scene = read("captures/beer")
    assert len(scene.split("train")) + len(scene.split("test")) == 71
    sparse = scene.sparse
    assert sparse is not None
    assert sparse.sightings is not None
    assert len(sparse) == 4414
    off: list[torch.Tensor] = []
    for split in scene.views.values():
        for view in split:
            rows, places = sparse.sightings.of(view.name)
            column, row, _ = view.camera.project(sparse.positions[rows])
            off.append((torch.stack([column, row], dim=1) - places).norm(dim=1))
    assert float(torch.cat(off).mean()) < 0.85


def test_dtu(read: Read) -> None:
    scene = read("captures/dtu_scan24")
    assert (len(scene.split("train")), len(scene.split("test"))) == (42, 7)
    view = scene.split("train")[0]
    assert view.has_alpha
    assert scene.region is not None
    assert scene.region.radius == pytest.approx(231.068, abs=1e-3)
    column, row, depth = view.camera.project(scene.region.center[None])
    assert float(depth) > 0
    assert 0 < float(column) < view.camera.width
    assert 0 < float(row) < view.camera.height


@pytest.mark.parametrize("name", ["lego", "chair"])
def test_rendered_scenes(read: Read, name: str) -> None:
    scene = read(f"nerf_synthetic/{name}")
    assert (len(scene.split("train")), len(scene.split("test"))) == (100, 50)
    assert scene.layout == "NeRF-Synthetic"

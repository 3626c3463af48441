"""Where Gaussians begin with masks: in the hull, or on the surface where the hull is open."""

import json
from pathlib import Path

import pytest
import torch

from pcore.capture.load import load_scene
from pcore.data.pictures import write_mask
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_start import chosen_start, start_gaussians
from room_scene import RADIUS, cameras, picture, write_room

COUNT = 24


def masked_room(folder: Path, kept: int) -> Scene:
    """The ball of a room with its true masks, the first of the views around it."""
    room = write_room(folder / "room", COUNT)
    content = json.loads((room / "transforms.json").read_text())
    content["frames"] = content["frames"][:kept]
    (room / "transforms.json").write_text(json.dumps(content))
    (folder / "masks").mkdir()
    for number, camera in enumerate(cameras(COUNT)):
        write_mask(folder / "masks" / f"{number:04d}.png", picture(camera)[1])
    return load_scene(room, masks=folder / "masks")


@pytest.mark.parametrize(("kept", "start"), [(COUNT, "hull"), (11, "views"), (7, "hull")])
def test_a_hull_that_is_open_is_no_start(tmp_path: Path, kept: int, start: str) -> None:
    assert chosen_start(masked_room(tmp_path, kept), "auto") == start


def test_points_lie_on_the_object(tmp_path: Path) -> None:
    scene = masked_room(tmp_path, 11)
    config = GaussianConfig(points=300, start="views")
    means = start_gaussians(
        scene, scene.split("train"), config, torch.Generator().manual_seed(0)
    ).means
    assert 30 < len(means) <= 300
    distances = means.norm(dim=-1)
    assert float((distances - RADIUS).abs().median()) < 0.15
    assert float(distances.max()) < 4.0


def test_masks_without_anything_common_are_refused(tmp_path: Path) -> None:
    scene = masked_room(tmp_path, 11)
    for file in (tmp_path / "masks").iterdir():
        write_mask(file, torch.nn.functional.pad(torch.ones(2, 2), (0, 62, 0, 46)))
    scene = load_scene(tmp_path / "room", masks=tmp_path / "masks")
    with pytest.raises(InputError, match="--init hull"):
        start_gaussians(
            scene,
            scene.split("train"),
            GaussianConfig(points=50, start="views"),
            torch.Generator().manual_seed(0),
        )

"""Points that are carried by those of somebody else, and states that are scored with them."""

from pathlib import Path

import numpy as np
import pytest
import torch

import published_sets
import tiny_scene
from pcore.asset.saving import asset_of
from pcore.errors import SceneError
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.protocol import STANDARD
from pcore.evaluation.runner import evaluate
from pcore.evaluation.state_moves import point_files
from pcore.evaluation.states import open_states
from pcore.model.papr import Papr
from tiny_scene import draw_box


def bend(points: torch.Tensor) -> torch.Tensor:
    return points + 0.3 * torch.stack([points[:, 2] ** 2, 0 * points[:, 0], 0 * points[:, 0]], 1)


def write_points(folder: Path, before: torch.Tensor, after: torch.Tensor) -> None:
    folder.mkdir(exist_ok=True)
    np.save(folder / "points_before.npy", before.numpy())
    np.save(folder / "points_after.npy", after.numpy())


def test_points_are_matched_by_position(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    cloud = 1.2 * torch.rand(80_000, 3, generator=generator) - 0.6
    write_points(tmp_path / "s", cloud, bend(cloud))
    ours = torch.rand(500, 3, generator=generator) - 0.5
    files = point_files(tmp_path / "s")
    assert files is not None
    move = files.move()
    assert float((move(ours) - bend(ours)).abs().max()) < 2e-3
    assert move(ours.clone()) is move(ours)
    # A stray goes along with the nearest; a cloud that lies elsewhere is refused.
    strays = torch.cat([ours, torch.tensor([[0.0, 0.0, 1.5]])])
    shift = move(strays)[-1] - strays[-1]
    torch.testing.assert_close(shift, torch.tensor([0.108, 0, 0]), atol=0.03, rtol=0)
    with pytest.raises(SceneError, match=r"points_before.npy: .* got half of the object's 500"):
        move(ours + 3)


def test_a_deformed_scene_of_neural_editor_is_scored(tmp_path: Path) -> None:
    states = open_states(published_sets.neural_editor(tmp_path))
    assert states.names == ("box_data",)
    asset = asset_of(Papr(tiny_scene.CONFIG), tiny_scene.corner_cloud())
    method = AssetMethod(name="true", asset=asset, rays="plain", take=draw_box)
    rows = evaluate([method], states.select(["all"]), protocols=[STANDARD])
    assert [(row.state, row.kind) for row in rows[2:]] == [("box_data", "skeletal")] * 2
    for row in rows:
        psnr = row.scores["psnr"]
        assert psnr is not None
        assert psnr > 30  # The box is drawn where its corners are found: to a thousandth.
        assert row.scores["hole_rate"] is None  # No mesh tells depth.


def test_bad_files_of_points(tmp_path: Path) -> None:
    cloud = torch.rand(100, 3)
    assert point_files(tmp_path) is None
    write_points(tmp_path / "short", cloud, cloud[1:])
    files = point_files(tmp_path / "short")
    assert files is not None
    with pytest.raises(SceneError, match=r"each of the 100 points of .*, got 99"):
        files.move()
    (tmp_path / "short" / "points_after.npy").unlink()
    with pytest.raises(
        SceneError, match=r"expected points_before and points_after, .* got points_b"
    ):
        point_files(tmp_path / "short")

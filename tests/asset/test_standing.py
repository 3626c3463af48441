"""How an object stands: as the cameras of its photos do, and without what stands around it."""

from dataclasses import replace
from pathlib import Path

import torch

from lying_world import in_lying_world
from pcore.asset.standing import standing_of


def test_up_is_that_of_the_photographer(tmp_path: Path) -> None:
    asset = in_lying_world(tmp_path / "toy")
    standing = standing_of(asset)
    assert float(standing.axes[:, 2] @ torch.tensor([0.0, -1.0, 0.0])) > 0.95
    assert torch.allclose(standing.axes.T @ standing.axes, torch.eye(3), atol=1e-5)
    assert len(standing.cameras) == 8
    assert standing.body(asset.points).tolist() == [True] * 200 + [False] * 5


def test_without_photos_z_is_up_and_all_is_the_object(tmp_path: Path) -> None:
    asset = in_lying_world(tmp_path / "toy")
    standing = standing_of(replace(asset, record=replace(asset.record, scene="gone")))
    assert torch.equal(standing.axes, torch.eye(3))
    assert standing.cameras == ()
    assert bool(standing.body(asset.points).all())

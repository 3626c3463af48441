"""How an object stands: as the cameras of its photos do, and without what stands around it."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from capture_files import write_photos
from lying_world import in_lying_world
from pcore.asset.standing import Standing, standing_of
from pcore.geometry.object_region import Region


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


def test_nobody_waits_for_poses_to_learn_what_is_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_photos(tmp_path / "holiday", [f"IMG_{i}.jpg" for i in range(5)])
    asset = in_lying_world(tmp_path / "toy")
    asset = replace(asset, record=replace(asset.record, scene=str(tmp_path / "holiday")))
    monkeypatch.setattr("pcore.capture.load.with_poses", lambda *_: pytest.fail("posed"))
    assert standing_of(asset).cameras == ()


def test_a_region_with_hardly_a_point_is_not_where_the_object_is() -> None:
    points = torch.rand(1000, 3, generator=torch.Generator().manual_seed(0))
    small = Region(center=torch.full((3,), 0.5), radius=0.05)
    assert bool(Standing(axes=torch.eye(3), region=small).body(points).all())
    large = replace(small, radius=0.3)
    assert 0 < int(Standing(axes=torch.eye(3), region=large).body(points).sum()) < 500

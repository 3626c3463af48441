"""How an object stands: as the cameras of its photos do, and without what stands around it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from capture_files import shots, write_photos, write_transforms
from gaussian_asset import asset_of_gaussians
from pcore.asset.asset import Asset
from pcore.asset.standing import standing_of
from pcore.gaussians.gaussians import Gaussians

LYING = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""A world whose -y was up, as COLMAP leaves them: z of the photographer is its -y."""


def in_lying_world(folder: Path) -> Asset:
    """An object in photos of a world that lies, with 20 Gaussians of it and 5 of the room."""
    photos = shots()
    for shot in photos:
        shot.matrix = np.linalg.inv(LYING) @ shot.matrix
    write_photos(folder / "images", [shot.name for shot in photos])
    write_transforms(folder, photos)
    random = torch.Generator().manual_seed(0)
    near = 0.2 * torch.rand(20, 3, generator=random)
    far = 50 + torch.rand(5, 3, generator=random)
    means = torch.cat([near, far])
    gaussians = Gaussians(
        means=means,
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(25, 1),
        scales=torch.full((25, 3), 0.02),
        opacities=torch.full((25,), 0.9),
        sh=torch.zeros(25, 1, 3),
    )
    asset = asset_of_gaussians(gaussians)
    return replace(asset, record=replace(asset.record, scene=str(folder)))


def test_up_is_that_of_the_photographer(tmp_path: Path) -> None:
    asset = in_lying_world(tmp_path / "toy")
    standing = standing_of(asset)
    assert float(standing.axes[:, 2] @ torch.tensor([0.0, -1.0, 0.0])) > 0.95
    assert torch.allclose(standing.axes.T @ standing.axes, torch.eye(3), atol=1e-5)
    assert len(standing.cameras) == 8
    assert standing.body(asset.points).tolist() == [True] * 20 + [False] * 5


def test_without_photos_z_is_up_and_all_is_the_object(tmp_path: Path) -> None:
    asset = in_lying_world(tmp_path / "toy")
    standing = standing_of(replace(asset, record=replace(asset.record, scene="gone")))
    assert torch.equal(standing.axes, torch.eye(3))
    assert standing.cameras == ()
    assert bool(standing.body(asset.points).all())

"""An object before a background, in photos of a world that lies on its side."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from capture_files import shots, write_photos, write_transforms
from pcore.asset.asset import Asset
from pcore.asset.saving import asset_of
from pcore.gaussians.gaussians import Gaussians

LYING = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""A world whose -y was up, as COLMAP leaves them: z of the photographer is its -y."""


def in_lying_world(folder: Path) -> Asset:
    """An object in photos of a world that lies, with 200 Gaussians of it and 5 of the room."""
    photos = shots()
    for shot in photos:
        shot.matrix = np.linalg.inv(LYING) @ shot.matrix
    write_photos(folder / "images", [shot.name for shot in photos])
    write_transforms(folder, photos)
    random = torch.Generator().manual_seed(0)
    near = 0.2 * torch.rand(200, 3, generator=random)
    far = 50 + torch.rand(5, 3, generator=random)
    means = torch.cat([near, far])
    gaussians = Gaussians(
        means=means,
        quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(205, 1),
        scales=torch.full((205, 3), 0.02),
        opacities=torch.full((205,), 0.9),
        sh=torch.zeros(205, 1, 3),
    )
    asset = asset_of(gaussians)
    return replace(asset, record=replace(asset.record, scene=str(folder)))

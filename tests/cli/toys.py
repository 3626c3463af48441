"""A toy scene with images of a ball, and a run of it that was never trained."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pcore.files.provenance import provenance_of
from pcore.files.run_folder import RunFolder
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig

CONFIG = PaprConfig(
    neighbours=3,
    octaves=Octaves.all(2),
    feature_size=5,
    key=MlpConfig(layers=2, width=8, size=8),
    query=MlpConfig(layers=2, width=8, size=8),
    value=MlpConfig(layers=2, width=8, size=4),
    unet_channels=(4, 6, 8),
    background_score=0.0,
)
ANGLE_X = 0.7
RADIUS = 0.8


def toy_cameras(count: int, *, size: int = 16, elevation: float = 0.4) -> list[Camera]:
    """Cameras around the origin."""
    return orbit_cameras(
        torch.zeros(3),
        4.0,
        count,
        elevation=elevation,
        width=size,
        height=size,
        angle_x=ANGLE_X,
    )


def write_cameras(path: Path, cameras: list[Camera], **keys: object) -> Path:
    """Write a transforms file whose frames are named r_0, r_1, ..."""
    frames = [
        {
            "file_path": f"./{path.stem.removeprefix('transforms_')}/r_{i}",
            "transform_matrix": camera.world_from_camera.tolist(),
        }
        for i, camera in enumerate(cameras)
    ]
    path.write_text(json.dumps({"camera_angle_x": ANGLE_X, "frames": frames, **keys}))
    return path


def write_scene(root: Path, *, train: int = 12, test: int = 2, alpha: bool = True) -> Path:
    """A NeRF-Synthetic scene of a ball that is red on one side and green on the other."""
    for split, count, elevation in (("train", train, 0.4), ("test", test, 0.1)):
        (root / split).mkdir(parents=True)
        cameras = toy_cameras(count, elevation=elevation)
        for index, camera in enumerate(cameras):
            image = Image.fromarray(_ball(camera))
            image.convert("RGBA" if alpha else "RGB").save(root / split / f"r_{index}.png")
        write_cameras(root / f"transforms_{split}.json", cameras)
    return root


def _ball(camera: Camera) -> np.ndarray:
    rays = camera.rays()
    middle = (rays.origins * rays.directions).sum(dim=-1)
    root = middle.square() - rays.origins.square().sum(dim=-1) + RADIUS**2
    hit = rays.origins + (-middle - root.clamp_min(0).sqrt()).unsqueeze(-1) * rays.directions
    red = (hit[..., 0] > 0).float()
    rgba = torch.stack([red, 1 - red, 0.5 * torch.ones_like(red), (root > 0).float()], dim=-1)
    return (rgba * 255).to(torch.uint8).numpy()


def toy_cloud(count: int = 40) -> PointCloud:
    """Random points on the ball."""
    positions = torch.nn.functional.normalize(torch.randn(count, 3), dim=-1) * RADIUS
    return PointCloud(
        positions=positions, features=torch.randn(count, 5), influence=torch.rand(count) + 0.5
    )


def toy_surfels(positions: Tensor) -> Surfels:
    """The surface over points on a ball, which lies a little above them."""
    normals = torch.nn.functional.normalize(positions, dim=1)
    return Surfels.at_rest(positions, normals, torch.full((len(positions),), 0.01))


def write_run(
    path: Path,
    *,
    scene: str = "",
    config: PaprConfig = CONFIG,
    points: int = 40,
    surfels: bool = False,
    **settings: object,
) -> tuple[Papr, PointCloud]:
    """Make a run folder of random networks; `settings` go into its run.json.

    With `surfels` it knows the surface over its points, as trained runs do.
    """
    papr, cloud = Papr(config).requires_grad_(False).eval(), toy_cloud(points)
    with RunFolder.create(path, stage="pretrain", scene=scene, config=settings) as run:
        came = provenance_of(
            cloud.positions, config.background, scene="toy", stage="pretrain", step=7
        )
        over = toy_surfels(cloud.positions) if surfels else None
        run.save_model(papr.state_dict(), cloud, config, came, over)
        run.update(status="finished", step=7)
    return papr, cloud


def logged_losses(run: Path) -> set[str]:
    """Names of the terms of the loss in the log of a run."""
    lines = map(json.loads, (run / "log.jsonl").read_text().splitlines())
    return {name for line in lines if line["event"] == "step" for name in line["losses"]}

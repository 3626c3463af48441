"""A scene of a painted box with deformed states, and models of it, made in a moment."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.posed_asset import Posed
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.files.provenance import provenance_of
from pcore.files.run_folder import RunFolder
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.model.papr_config import MlpConfig, Octaves, PaprConfig
from pcore.render.image import Image as Drawn

SIZE, ANGLE = 24, 0.7
CONFIG = PaprConfig(
    neighbours=4,
    octaves=Octaves.all(2),
    feature_size=4,
    key=MlpConfig(layers=2, width=8, size=8),
    query=MlpConfig(layers=2, width=8, size=8),
    value=MlpConfig(layers=2, width=8, size=4),
    unet_channels=(4, 6, 8),
)
CORNERS = np.array(
    [[x, y, z] for x in (-0.6, 0.6) for y in (-0.45, 0.45) for z in (-0.35, 0.35)], dtype=np.float64
)
FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ]
)


def _sheared(vertices: np.ndarray) -> np.ndarray:
    moved = vertices.copy()
    moved[:, 0] += 0.4 * vertices[:, 2]
    return moved


STATES: dict[str, tuple[Any, dict[str, Any]]] = {
    "grown": (lambda v: 1.5 * v, {"type": "scale", "factor": 1.5}),
    "walk": (_sheared, {"type": "animation"}),
    "twist60": (_sheared, {"type": "simple_deform", "driver_lo": -1.0, "driver_hi": 1.0}),
    "bend60": (_sheared, {"type": "simple_deform", "driver_lo": -1.0, "driver_hi": 1.0}),
    "stretch": (_sheared, {"type": "simple_deform", "driver_lo": -1.0, "driver_hi": 1.0}),
    "scale2x": (lambda v: 1.2 * v, {"type": "scale", "factor": 1.2}),
}


def see(vertices: np.ndarray, camera: Camera) -> tuple[Tensor, Tensor]:
    """True image (H, W, 4) of the box in one colour and its depth (H, W)."""
    depth = mesh_depth(vertices, FACES, camera)
    alpha = depth.isfinite().float()
    color = torch.tensor([204, 102, 51]) / 255
    return torch.cat([alpha[..., None] * color, alpha[..., None]], dim=-1), depth


def draw_box(asset: Asset, posed: Posed, camera: Camera) -> Drawn:
    """Renderer that is perfect when the points are the corners of the box."""
    rgba, depth = see(posed.points.double().numpy(), camera)
    alpha = rgba[..., 3:]
    return Drawn(
        rgb=rgba[..., :3] + 1 - alpha,
        alpha=alpha[..., 0],
        depth=torch.where(depth.isfinite(), depth, torch.nan),
        surface=torch.zeros(*depth.shape, 3),
    )


def write_scene(
    root: Path,
    *,
    meshes: bool = True,
    states: bool = True,
    names: tuple[str, ...] = ("grown", "walk"),
) -> Path:
    """Write the scene: 6 training and 2 test views, and those of `STATES` that are named."""
    cameras = orbit(8)
    write_split(root, "train", CORNERS, cameras[:6])
    write_split(root, "test", CORNERS, cameras[6:])
    moved = {name: move(CORNERS) for name, (move, _) in STATES.items()} if states else {}
    moved = {name: moved[name] for name in moved if name in names}
    for name, vertices in moved.items():
        write_split(root / name, "test", vertices, cameras[6:])
        (root / name / "deformation.json").write_text(json.dumps(STATES[name][1]))
    if meshes:
        np.savez(root / "meshes.npz", canonical=CORNERS, faces=FACES, **moved)
    return root


def orbit(count: int) -> list[Camera]:
    return orbit_cameras(
        torch.zeros(3), 4.0, count, elevation=0.5, width=SIZE, height=SIZE, angle_x=ANGLE
    )


def corner_cloud() -> PointCloud:
    """The corners of the box as a cloud, for `draw_box`."""
    return PointCloud(
        positions=torch.from_numpy(CORNERS).float(),
        features=torch.zeros(8, CONFIG.feature_size),
        influence=torch.ones(8),
    )


def write_run(
    path: Path, scene: Path, *, stage: str = "pretrain", surfels: bool = False, **config: Any
) -> Path:
    """Write a finished run of a random model whose points lie about the box.

    With `surfels` they face outwards.
    """
    positions = (torch.rand(60, 3) - 0.5) * torch.tensor([1.2, 0.9, 0.7])
    cloud = PointCloud(
        positions=positions, features=torch.randn(60, 4), influence=1 + torch.rand(60)
    )
    with RunFolder.create(path, stage=stage, scene=str(scene), config=config) as run:
        came = provenance_of(
            cloud.positions, CONFIG.background, scene=scene.name, stage=stage, step=1
        )
        normals = torch.nn.functional.normalize(positions, dim=1)
        over = Surfels.at_rest(positions, normals, torch.full((60,), 0.01)) if surfels else None
        run.save_model(Papr(CONFIG).state_dict(), cloud, CONFIG, came, over)
        run.update(status="finished")
    return path


def write_split(root: Path, split: str, vertices: np.ndarray, cameras: list[Camera]) -> None:
    (root / split).mkdir(parents=True)
    frames = []
    for i, camera in enumerate(cameras):
        rgba, _ = see(vertices, camera)
        Image.fromarray((rgba * 255).round().byte().numpy()).save(root / split / f"r_{i}.png")
        pose = camera.world_from_camera.tolist()
        frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose})
    content = {"camera_angle_x": ANGLE, "frames": frames}
    (root / f"transforms_{split}.json").write_text(json.dumps(content))

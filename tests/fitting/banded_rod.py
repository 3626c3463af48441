"""A rod of Gaussians in coloured bands, one with an arm, and photos of them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.saving import asset_of
from pcore.editing.script import EditScript
from pcore.fitting.anchor_motion import rotation_matrices
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from tiny_scene import CONFIG

LENGTH = 1.6
COUNT = 400
SIDE = 32


def rod(*, bands: float = 9.0, radius: float = 0.15, scale: float = 1.0) -> Asset:
    """A rod along x of a radius, whose colours change along and around it."""
    means, colors = _banded(bands, radius)
    return _asset(scale * means, colors, 0.045 * scale)


def neural_rod(*, bands: float = 9.0, radius: float = 0.15) -> Asset:
    """The same of neural points: networks that never learned blend the points' colours."""
    places, colors = _banded(bands, radius)
    features = torch.zeros(COUNT, 4)
    features[:, :3] = colors
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        papr = Papr(replace(CONFIG, point_colors=True, cutoff=0.06, background_score=-30.0))
    for parameter in papr.unet.outc.parameters():
        torch.nn.init.zeros_(parameter)
    cloud = PointCloud(positions=places, features=features, influence=torch.ones(COUNT))
    return asset_of(papr.requires_grad_(False).eval(), cloud)


def _banded(bands: float, radius: float) -> tuple[Tensor, Tensor]:
    """Places and colours (COUNT, 3) on the surface of a rod along x."""
    draw = torch.Generator().manual_seed(1)
    along = LENGTH * (torch.rand(COUNT, generator=draw) - 0.5)
    angle = 2 * torch.pi * torch.rand(COUNT, generator=draw)
    places = torch.stack([along, radius * angle.cos(), radius * angle.sin()], dim=1)
    phases = torch.tensor([0.0, 2.0, 4.0])
    colors = 0.5 + 0.4 * torch.sin(bands * along[:, None] + phases + 0.5 * angle.cos()[:, None])
    return places, colors


def armed(angle: float) -> Asset:
    """An upright bar with a thin arm on one side, which hangs down and is raised by an angle."""
    draw = torch.Generator().manual_seed(2)
    along, around = torch.rand(COUNT, generator=draw), torch.rand(COUNT, generator=draw)
    around = 2 * torch.pi * around
    ring = torch.stack([around.cos(), around.sin()], dim=1)
    arm = torch.arange(COUNT) >= 260
    body = torch.cat([0.14 * ring, 1.2 * along[:, None] - 0.6], dim=1)
    hanging = torch.cat([0.05 * ring, 0.33 - 1.1 * along[:, None]], dim=1)
    # A third of the arm reaches out from the bar and stays.
    shoulder = (along < 0.33)[:, None]
    reaching = torch.cat([1.2 * along[:, None], 0.05 * ring], dim=1)
    joint = torch.tensor([0.4, 0.0, 0.0])
    turn = rotation_matrices(torch.tensor([[0.0, -angle, 0.0]]))[0]
    raised = torch.where(shoulder, reaching, (hanging @ turn.mT) + joint)
    means = torch.where(arm[:, None], raised + torch.tensor([0.0, 0.0, 0.4]), body)
    phases = torch.tensor([0.0, 2.0, 4.0])
    colors = 0.5 + 0.4 * torch.sin(8 * along[:, None] + phases + 2.0 * arm[:, None])
    return _asset(means, colors, 0.045)


def _asset(means: Tensor, colors: Tensor, width: float) -> Asset:
    gaussians = Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(COUNT, 1),
        scales=torch.full((COUNT, 3), width),
        opacities=torch.full((COUNT,), 0.95),
        sh=((colors - 0.5) / 0.28209479).unsqueeze(1),
    )
    return asset_of(gaussians)


def cameras(count: int, *, elevation: float = 0.3, scale: float = 1.0) -> list[Camera]:
    """Cameras around the rod."""
    around = orbit_cameras(
        torch.zeros(3), 4 * scale, count, elevation=elevation, width=SIDE, height=SIDE, angle_x=0.6
    )
    return list(around)


def write_photos(folder: Path, asset: Asset, posed: Posed | None, places: Sequence[Camera]) -> Path:
    """Write photos of a posed object, with masks, as a scene; return its folder."""
    (folder / "train").mkdir(parents=True)
    frames = []
    for number, camera in enumerate(places):
        seen = asset.over((0.0, 0.0, 0.0)).render(posed, camera)
        alpha = seen.alpha.unsqueeze(-1)
        rgba = torch.cat([seen.rgb / alpha.clamp_min(1e-4), alpha], dim=-1).clamp(0, 1)
        pixels = (255 * rgba).round().byte().numpy()
        Image.fromarray(pixels).save(folder / "train" / f"r_{number}.png")
        pose = camera.world_from_camera.tolist()
        frames.append({"file_path": f"./train/r_{number}", "transform_matrix": pose})
    angle = 2 * math.atan(SIDE / (2 * places[0].fx))
    content = {"camera_angle_x": angle, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(content))
    return folder


def error_from_aside(asset: Asset, true: Asset, edit: EditScript) -> float:
    """Mean error of an edited object's colours from a camera that no photo was taken by."""
    (camera,) = cameras(1, elevation=0.6)
    pictures = (one.render(one.pose(edit), camera).rgb for one in (asset, true))
    return float(torch.sub(*pictures).abs().mean())

"""Points and rays that look like learned ones, of any number: made, so that no data is needed."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import normalize

from benchmarks import dense
from pcore.deform.frame import axis_frame
from pcore.deform.simple import Twist
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.papr import Papr
from pcore.model.papr_config import PaprConfig
from pcore.render.picture import render, render_rays

_DISTANCE = 4.0
_ANGLE = 0.6911
"""Distance and field of view of the cameras of NeRF-Synthetic, whose objects have this size."""


def cloud(count: int) -> Tensor:
    """Points (N, 3) of a bumpy surface with a little thickness."""
    generator = torch.Generator().manual_seed(0)
    d = normalize(torch.randn(count, 3, generator=generator), dim=-1)
    bumps = 0.25 * torch.sin(5 * d[:, :1]) * torch.cos(4 * d[:, 1:2]) + 0.15 * torch.sin(
        9 * d[:, 2:]
    )
    noise = 0.002 * torch.randn(count, 3, generator=generator)
    return d * (0.6 + bumps) * torch.tensor([1.0, 0.7, 1.1]) + noise


def camera(size: int) -> Camera:
    """Look at the cloud from the side and from above."""
    return orbit_cameras(
        torch.zeros(3), _DISTANCE, 8, elevation=0.45, width=size, height=size, angle_x=_ANGLE
    )[1]


def patch(side: int, size: int) -> RayBundle:
    """Rays (side, side) of the middle of an image of `size` pixels a side."""
    corner = (size - side) // 2
    return camera(size).rays(corner, corner, side, side)


def near_surface(side: int, size: int, points: Tensor) -> tuple[RayBundle, Tensor]:
    """Rays with an origin each, shortly before the points, and the points, both twisted.

    What fine-tuning passes in its rays-and-points mode.
    """
    rays = patch(side, size).flat()
    # Any surface will do: the half of the points that faces the camera, nearest in angle.
    front = points[(points * rays.origins[0]).sum(dim=-1) > 0]
    seen = normalize(front - rays.origins[0], dim=-1)
    ends = torch.cat([front[(part @ seen.T).argmax(dim=-1)] for part in rays.directions.split(256)])
    along = ((ends - rays.origins) * rays.directions).sum(dim=-1, keepdim=True)
    ends = rays.origins + along * rays.directions
    twist = Twist(rotation=axis_frame("z"), origin=torch.zeros(3), extent=(-1.0, 1.0), value=1.5)
    ends, origins = twist(ends), twist(ends - 0.1 * _DISTANCE * rays.directions)
    moved = RayBundle(origins=origins, directions=normalize(ends - origins, dim=-1))
    return moved, twist(points)


def on_device(rays: RayBundle, device: torch.device) -> RayBundle:
    """Return the rays on a device."""
    return RayBundle(origins=rays.origins.to(device), directions=rays.directions.to(device))


def doubled(rays: RayBundle) -> RayBundle:
    """Return the rays in float64."""
    return RayBundle(origins=rays.origins.double(), directions=rays.directions.double())


def training_colours(papr: Papr, cloud: PointCloud, rays: RayBundle) -> Tensor:
    """Colours (H, W, 3) of rays as a step of training renders them, with gradients."""
    posed = PosedCloud.at_rest(cloud)
    return render_rays(papr, posed, rays, stop_encoding=True, geometry=False).rgb


@torch.no_grad()
def picture(papr: Papr, cloud: PointCloud, camera: Camera, threshold: float = 0.0) -> Tensor:
    """Colours (H, W, 3) that a camera sees, as `pcore render` draws them."""
    return render(papr, PosedCloud.at_rest(cloud), camera, threshold=threshold).rgb


def papr(config: PaprConfig, points: Tensor, device: torch.device) -> tuple[Papr, PointCloud]:
    """PAPR that has not been trained, with these points; gradients of everything are wanted.

    Untrained, all keys of a ray are almost the same, and its scores all cut to zero or none. The
    mean key is therefore taken away: about half of the scores are cut, as in trained models.
    """
    torch.manual_seed(0)
    networks = Papr(config)
    tensors = {
        "positions": points,
        "features": torch.randn(len(points), config.feature_size),
        "influence": torch.ones(len(points)),
    }
    keys: list[Tensor] = []

    def keep(_module: object, _inputs: object, output: Tensor) -> None:
        keys.append(output)

    hook = networks.attention.key.register_forward_hook(keep)
    with torch.no_grad():
        dense.papr_picture(networks, PointCloud.from_tensors(tensors), patch(8, 40))
        networks.attention.key.outnorm.offset.sub_(keys[0].mean(dim=(0, 1)))
    hook.remove()
    wanted = {name: one.to(device).requires_grad_() for name, one in tensors.items()}
    return networks.to(device), PointCloud.from_tensors(wanted)

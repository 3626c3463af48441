"""A ball in a room, photographed from a ring of cameras: photos with a background, known masks."""

import json
import math
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from pcore.capture.auto_masks import Photo
from pcore.data.sparse import SparsePoints
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras

WIDTH, HEIGHT, RADIUS = 64, 48, 0.7
ROOM = 9.0


def similarity(scale: float = 1000.0) -> tuple[Tensor, Tensor, float]:
    """A turn (3, 3), a shift (3,) in new units, and a scale."""
    angle = 0.8
    turn = torch.tensor(
        [
            [math.cos(angle), -math.sin(angle), 0.0],
            [math.sin(angle), math.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
    )
    return turn, scale * torch.tensor([3.0, -2.0, 5.0]), scale


def moved_camera(camera: Camera, motion: tuple[Tensor, Tensor, float]) -> Camera:
    turn, shift, scale = motion
    pose = camera.world_from_camera.clone()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = scale * (turn @ camera.center) + shift
    return camera.moved(pose)


def cameras(count: int = 12) -> list[Camera]:
    return orbit_cameras(
        torch.zeros(3),
        4.0,
        count,
        elevation=0.4,
        width=WIDTH,
        height=HEIGHT,
        angle_x=0.9,
    )


def picture(camera: Camera, light: float = 1.0) -> tuple[Tensor, Tensor]:
    """(H, W, 3) of an orange ball in a blue room with stripes, and its mask (H, W)."""
    rays = camera.rays()
    o, d = rays.origins, rays.directions
    b = (o * d).sum(-1)
    c = (o * o).sum(-1) - RADIUS**2
    hit = b * b - c > 0
    near = -b - (b * b - c).clamp_min(0).sqrt()
    at = o + near[..., None] * d
    ball = torch.stack([0.9 + 0 * b, 0.45 + 0.2 * torch.sin(9 * at[..., 2]), 0.1 + 0 * b], dim=-1)
    c = (o * o).sum(-1) - ROOM**2
    far = o + (-b + (b * b - c).sqrt())[..., None] * d
    # Every direction of the room has another look, so that folded poses show.
    turn = torch.atan2(far[..., 1], far[..., 0])
    stripes = 0.5 + 0.35 * torch.sin(3 * turn + torch.sin(2 * turn)) * torch.cos(far[..., 2] / 2)
    wall = torch.stack([0.1 + 0 * b, 0.9 * stripes, 0.3 + 0.7 * stripes], dim=-1)
    return light * torch.where(hit[..., None], ball, wall), hit.float()


def photos(count: int = 12) -> tuple[list[Photo], list[Tensor]]:
    """Photos and their true masks."""
    found, masks = [], []
    for number, camera in enumerate(cameras(count)):
        rgb, mask = picture(camera)
        found.append(Photo(name=f"{number:04d}", camera=camera, rgb=rgb))
        masks.append(mask)
    return found, masks


def sparse_points(seed: int = 0) -> SparsePoints:
    """Many points on the ball, few on the room's walls."""
    generator = torch.Generator().manual_seed(seed)
    ball = torch.nn.functional.normalize(torch.randn(600, 3, generator=generator), dim=-1) * RADIUS
    room = torch.nn.functional.normalize(torch.randn(80, 3, generator=generator), dim=-1) * ROOM
    return SparsePoints(positions=torch.cat([ball, room]))


def write_room(
    folder: Path,
    count: int = 12,
    *,
    swapped: tuple[int, int] | None = None,
    dark: int | None = None,
) -> Path:
    """Write `transforms.json` and photos; two photos may be swapped, one may be dark."""
    (folder / "images").mkdir(parents=True)
    frames = []
    shot = cameras(count)
    order = list(range(count))
    if swapped is not None:
        order[swapped[0]], order[swapped[1]] = swapped[1], swapped[0]
    for number, camera in enumerate(shot):
        rgb, _ = picture(shot[order[number]], 0.4 if number == dark else 1.0)
        pixels = (255 * rgb.clamp(0, 1)).round().byte().numpy()
        Image.fromarray(pixels).save(folder / "images" / f"{number:04d}.png")
        frames.append(
            {
                "file_path": f"images/{number:04d}.png",
                "transform_matrix": camera.world_from_camera.tolist(),
            }
        )
    first = shot[0]
    top = {"w": WIDTH, "h": HEIGHT, "fl_x": first.fx, "fl_y": first.fy}
    top |= {"cx": first.cx, "cy": first.cy}
    (folder / "transforms.json").write_text(json.dumps({**top, "frames": frames}))
    return folder

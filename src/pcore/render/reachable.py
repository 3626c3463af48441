"""Which pixels can show anything: those near to where a point is seen.

A ray that passes every point by more than the cut-off is pure background, and need not be sent.
"""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.geometry.camera import Camera
from pcore.geometry.posed import PosedCloud

_SLACK = 1.001
"""On the cut-off: rounding must not lose a ray."""


@torch.no_grad()
def reachable(posed: PosedCloud, camera: Camera, cutoff: float | None) -> Tensor | None:
    """Pixels whose rays may pass a point within the cut-off, bool (H, W) on the CPU; None: any.

    Never too few: around every point lies the rectangle that its sphere is seen in. Where a pose
    stretches space a point is met from so many times as far.

    Args:
        posed: the points.
        camera: who looks.
        cutoff: distance beyond which a point gets no attention, world units; None: no limit.
    """
    if cutoff is None:
        return None
    pose = camera.world_from_camera.detach().cpu().double()
    local = (posed.positions.detach().cpu().double() - pose[:3, 3]) @ pose[:3, :3]
    reach = torch.full_like(local[:, 0], _SLACK * cutoff)
    if posed.local_maps is not None:
        reach = reach * posed.local_maps.stretch.detach().cpu().double()
    depth = -local[:, 2]
    # A sphere around the camera, or beside it, is seen everywhere.
    if not bool((depth > reach).all()):
        return None
    spans: list[tuple[Tensor, Tensor]] = []
    for along, focal, middle, size in (
        (local[:, 0], camera.focal[0], camera.cx, camera.width),
        (-local[:, 1], camera.focal[1], camera.cy, camera.height),
    ):
        angle, half = torch.atan2(along, depth), torch.asin(reach / torch.hypot(along, depth))
        first, last = angle - half, angle + half
        if not bool(((first > -torch.pi / 2) & (last < torch.pi / 2)).all()):
            return None
        center = float(torch.as_tensor(middle).detach())
        # A pixel more on either side, for the rays beside its centre.
        begin = (focal * first.tan() + center).floor() - 1
        end = (focal * last.tan() + center).floor() + 2
        spans.append((begin.clamp(0, size).long(), end.clamp(0, size).long()))
    (left, right), (top, bottom) = spans
    counts = torch.zeros(camera.height + 1, camera.width + 1, dtype=torch.int64)
    one = torch.ones_like(left)
    for rows, columns, sign in (
        (top, left, 1),
        (top, right, -1),
        (bottom, left, -1),
        (bottom, right, 1),
    ):
        counts.index_put_((rows, columns), sign * one, accumulate=True)
    return counts.cumsum(0).cumsum(1)[:-1, :-1] > 0

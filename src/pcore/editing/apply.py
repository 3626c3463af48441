"""A deformation applied to a cloud, for rendering."""

from __future__ import annotations

import torch

from pcore.deform.base import Deformation, Identity
from pcore.deform.jacobian import analytic_frames
from pcore.geometry.point_cloud import PointCloud
from pcore.relight.shading import Shading


def deformed_cloud(
    cloud: PointCloud,
    deformation: Deformation,
    *,
    aware: bool = True,
    shading: Shading | None = None,
) -> PointCloud:
    """Move a canonical cloud; positions and frames are computed in double precision.

    Args:
        cloud: canonical points, world units.
        deformation: the map, as `EditScript.bind` returns it.
        aware: remember the rest state, so that PAPR renders with deformation-aware rays. A map
            that is the identity at every point needs no memory: the picture is the canonical one.
        shading: cover the points with their surface, lit anew by this light, which stays where it
            is; None leaves them as they were photographed.

    Returns:
        The moved cloud, on the device of the given one.

    Raises:
        EditError: with `aware` or `shading`, the map folds space or leaves the finite numbers at
            some points.
        InputError: a shading of another number of points.
    """
    positions = cloud.positions.detach()
    exact = positions.cpu().double()
    moved = deformation(exact).to(positions)
    if not (aware or shading):
        return cloud.moved(moved)
    if _stays(deformation, exact):
        return cloud.moved(moved).covered(shading and shading.rest.to(positions.device))
    frames = analytic_frames(deformation, positions.cpu())
    there = cloud.to("cpu").moved(moved.cpu(), frames if aware else None)
    return there.covered(shading and shading.skin(frames, there.positions)).to(positions.device)


def _stays(deformation: Deformation, points: torch.Tensor) -> bool:
    """Whether the map and its Jacobian are the identity at every point, to the last bit."""
    still = Identity()
    return torch.equal(deformation(points), points) and torch.equal(
        deformation.jacobian(points), still.jacobian(points)
    )

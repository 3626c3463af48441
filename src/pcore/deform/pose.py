"""A deformation applied to a cloud: what is drawn."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from pcore.deform.base import Deformation, Identity
from pcore.deform.jacobian import analytic_maps, unchecked_maps
from pcore.errors import EditError
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surfels import Surfels


def pose(
    cloud: PointCloud,
    deformation: Deformation,
    *,
    surfels: Surfels | None = None,
    aware: bool = True,
) -> PosedCloud:
    """Move a canonical cloud; positions and local maps are computed in double precision.

    Autograd follows the points, and parameters of the deformation that ask for it.

    Args:
        cloud: canonical points, world units.
        deformation: the map, as `EditScript.bind` returns it.
        surfels: the surface over the points at rest; None where it is not known.
        aware: keep the local maps, so that PAPR renders with deformation-aware rays. A map that is
            the identity at every point needs none: the picture is the canonical one.

    Returns:
        The posed cloud, on the device of the given one.

    Raises:
        EditError: with `aware`, the map folds space or leaves the finite numbers at some points; or
            a gradient is asked for that the deformation does not have.
    """
    exact = cloud.positions.cpu().double()
    moved = moved_points(deformation, exact)
    if not moved.requires_grad and _stays(deformation, exact):
        return PosedCloud.at_rest(cloud, surfels)
    posed = PosedCloud(cloud=cloud, positions=moved.to(cloud.positions))
    if not aware and surfels is None:
        return posed
    maps_at = analytic_maps if aware else unchecked_maps
    places = exact if moved.requires_grad else exact.detach()
    maps = maps_at(deformation, places, followed=moved.requires_grad)
    maps = maps.each(lambda matrices: matrices.to(cloud.positions))
    return replace(
        posed,
        local_maps=maps if aware else None,
        surfels=None if surfels is None else surfels.moved(posed.positions, maps),
    )


def moved_points(deformation: Deformation, points: Tensor) -> Tensor:
    """Where a deformation takes points (N, 3), with the gradient that is asked for.

    Raises:
        EditError: the points or a parameter ask for a gradient that the deformation does not have.
    """
    asking = [name for name, one in vars(deformation).items() if _asks(one)]
    asking += ["the canonical points"] * points.requires_grad
    asked = torch.is_grad_enabled() and bool(asking)
    try:
        moved = deformation(points)
    except RuntimeError as error:
        if not asked or "grad" not in str(error):
            raise
        raise _without_gradient(deformation, asking) from error
    if asked and not moved.requires_grad:
        raise _without_gradient(deformation, asking)
    return moved


def _asks(value: object) -> bool:
    """Whether autograd follows a field of a deformation: a tensor, a network, another map."""
    if isinstance(value, Tensor):
        return value.requires_grad
    if isinstance(value, nn.Module):
        return any(_asks(one) for one in value.parameters())
    if isinstance(value, Deformation):
        return any(_asks(one) for one in vars(value).values())
    return isinstance(value, tuple | list) and any(_asks(one) for one in value)  # pyright: ignore


def _without_gradient(deformation: Deformation, asking: list[str]) -> EditError:
    return EditError(
        f"{type(deformation).__name__}: a gradient to {', '.join(asking)} is asked for, and this "
        "deformation has none; use torch operations in it, or detach what asks"
    )


def _stays(deformation: Deformation, points: Tensor) -> bool:
    """Whether the map and its Jacobian are the identity at every point, to the last bit."""
    still, points = Identity(), points.detach()
    with torch.no_grad():
        return torch.equal(deformation(points), points) and torch.equal(
            deformation.jacobian(points), still.jacobian(points)
        )

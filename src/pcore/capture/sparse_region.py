"""Which of the points of a reconstruction are the object, and the region that they give."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from pcore.data.poses import closest_to_axes
from pcore.data.sparse import SparsePoints
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region, region_of_box

_NEIGHBOURS = 8
_LINK = 1.5
"""Points are of one thing when they are no farther apart than that many usual spacings."""
_LEAST = 50
_ERROR, _TRACK = 2.0, 3
"""Points with a larger error in pixels, or in fewer photos, are left out."""
_OUTLIERS = 0.01
"""Share of the object's points that may lie outside of the box on every side."""
_MARGIN = 0.06
"""Room around the object's points, as a share of the box's longest side."""


def object_points(sparse: SparsePoints, cameras: Sequence[Camera]) -> Tensor | None:
    """Points (M, 3) of the largest dense thing near the middle of what the cameras look at.

    The object of a capture is photographed from nearest and most often: its points lie close to
    the viewing axes and to one another; those of floor and walls are bare.

    Args:
        sparse: of the scene.
        cameras: of the training views.

    Returns:
        None where the viewing axes are parallel or too few points lie near their middle.
    """
    middle = closest_to_axes(torch.stack([camera.world_from_camera for camera in cameras]))
    if middle is None:
        return None
    places = _reliable(sparse)
    centers = torch.stack([camera.center for camera in cameras]).double().numpy()
    distance = float(np.median(np.linalg.norm(centers - middle.numpy(), axis=1)))
    away = np.linalg.norm(places - middle.numpy(), axis=1) / distance
    if int((away < 1).sum()) < _LEAST:
        return None
    spacing = KDTree(places).query(places, k=min(len(places), _NEIGHBOURS + 1))[0][:, -1]
    link = _LINK * float(np.median(spacing[away < 1]))
    dense = np.flatnonzero(spacing <= link)
    tree = KDTree(places[dense])
    _, label = connected_components(tree.sparse_distance_matrix(tree, link), directed=False)
    # The weight of what is far from the middle falls: a poster is dense too.
    worth = np.bincount(label, weights=1 / (1 + (away[dense] / 0.25) ** 2))
    chosen = places[dense[label == worth.argmax()]]
    return torch.from_numpy(chosen).float() if len(chosen) >= _LEAST else None


def region_of_points(points: Tensor) -> Region:
    """Return the box that nearly all points (N, 3) of an object lie in, with room around it."""
    edges = torch.tensor([_OUTLIERS, 1 - _OUTLIERS])
    lower, upper = torch.quantile(points, edges, dim=0)
    room = _MARGIN * (upper - lower).max()
    return region_of_box(lower - room, upper + room)


def _reliable(sparse: SparsePoints) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    kept = torch.isfinite(sparse.positions).all(dim=-1)
    if sparse.errors is not None:
        kept &= sparse.errors < _ERROR
    seen = sparse.seen_by
    if seen is not None:
        kept &= seen >= _TRACK
    return sparse.positions[kept].double().numpy()

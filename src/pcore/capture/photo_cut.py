"""One photo's cut: GrabCut (Rother et al. 2004) from an outline, and what it begins with."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.capture.voted_hull import Bits, require_opencv
from pcore.geometry.camera import Camera
from pcore.geometry.object_region import Region

Colours = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Mixtures (1, 65) of the colours of background and object, as OpenCV keeps them."""

_MARGIN = 0.12
"""Room around an outline in which the cut may still find object, as a share of its size."""
_FIRST, _AGAIN = 2, 1
"""Steps of a cut from nothing, and of one that begins with colours that another one found."""


def outline(camera: Camera, points: Tensor) -> Bits:
    """Convex outline (H, W) 0 or 1 of points in a picture; empty where all are behind it."""
    cv2 = require_opencv()
    column, row, depth = camera.project(points)
    ahead = depth > 0
    picture = np.zeros((camera.height, camera.width), dtype=np.uint8)
    if int(ahead.sum()) < 3:
        return picture
    corners = torch.stack([column, row], dim=-1)[ahead].numpy()
    limit = 8.0 * max(camera.width, camera.height)
    hull = cv2.convexHull(np.clip(corners, -limit, limit).round().astype(np.int32))
    return cv2.fillConvexPoly(picture, hull, 1)


def _reach(seed: Bits) -> int:  # Pixels around an outline that the cut may still take.
    return max(2, round(_MARGIN * math.sqrt(float(seed.sum()))))


def near_outline(seed: Bits, room: Bits, region: Region) -> Bits:
    """What is not known to be background: a sphere has room in it, a box may be tight."""
    return room if region.box is None else _grown(seed, _reach(seed)) | room


def cut(
    rgb: Tensor, seed: Bits, near: Bits, core: Bits | None, begin: Colours | None
) -> tuple[Bits, Colours | None]:
    """GrabCut (H, W) 0 or 1 from an outline, near it; inside of a core is object for certain.

    Returns:
        The mask, and the colours of background and object; None where nothing was cut.
    """
    cv2 = require_opencv()
    if not seed.any() or near.all():
        return seed, None  # There is no object, or nothing is known to be background.
    trimap = np.full(seed.shape, cv2.GC_BGD, dtype=np.uint8)
    trimap[near > 0] = cv2.GC_PR_BGD
    trimap[seed > 0] = cv2.GC_PR_FGD
    if core is not None:
        trimap[_shrunken(core, _reach(seed)) > 0] = cv2.GC_FGD
    pixels = np.ascontiguousarray((255 * rgb.clamp(0, 1)).round().byte().numpy())
    models = (np.zeros((1, 65)), np.zeros((1, 65))) if begin is None else begin
    models = models[0].copy(), models[1].copy()  # They are written to.
    how = (_FIRST, cv2.GC_INIT_WITH_MASK) if begin is None else (_AGAIN, cv2.GC_EVAL)
    # OpenCV draws its clusters from a generator of the thread.
    cv2.setRNGSeed(0)
    cv2.grabCut(pixels, trimap, None, *models, *how)
    found = ((trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)).astype(np.uint8)
    found = cv2.morphologyEx(found, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return _largest(found, seed), models


def _largest(mask: Bits, seed: Bits) -> Bits:
    """The parts of a mask that reach into the seed, without specks and with small holes closed."""
    cv2 = require_opencv()
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask
    areas = stats[1:, cv2.CC_STAT_AREA]
    inside = np.bincount(labels[seed > 0], minlength=count)[1:]
    kept = [i + 1 for i in range(count - 1) if areas[i] >= 0.1 * areas.max() and inside[i] > 0]
    whole = np.isin(labels, kept).astype(np.uint8)
    return cv2.morphologyEx(whole, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))


def _grown(mask: Bits, reach: int) -> Bits:
    cv2 = require_opencv()
    return cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2))


def _shrunken(mask: Bits, reach: int) -> Bits:
    cv2 = require_opencv()
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)
    # What the border of the picture cuts off goes on behind it.
    return cv2.erode(mask, kernel, borderType=cv2.BORDER_REPLICATE)


def resized(mask: Bits, camera: Camera) -> Tensor:
    """A mask in the size of its photo, with a rim of a pixel's softness."""
    cv2 = require_opencv()
    size = (camera.width, camera.height)
    if mask.shape == (camera.height, camera.width):
        return torch.from_numpy(255 * mask)
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7)
    large = cv2.resize(smooth, size, interpolation=cv2.INTER_CUBIC)
    factor = max(1.0, camera.width / mask.shape[1])
    soft = np.clip((large - 0.5) * factor + 0.5, 0.0, 1.0)
    return torch.from_numpy((255 * soft).round().astype(np.uint8))

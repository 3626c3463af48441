"""The world that poses are given in when nobody else has chosen one: z up, the object at 0.

Structure from motion knows places up to a similarity, and COLMAP leaves whatever its first pair of
photos gave: an object that lies on its side, far from the origin, of any size. Numpy alone, since
the child that runs COLMAP uses it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcore.geometry.upward import Floats, upward

DISTANCE = 4.0
"""Median distance of the cameras from the object, as in rendered scenes."""


@dataclass(frozen=True)
class Similarity:
    """Places x of an old world are at `scale * rotation @ x + translation` in a new one."""

    scale: float
    rotation: Floats
    translation: Floats


def upright(world_from_camera: Floats) -> Similarity:
    """The map to a world in which the object stands at the origin as the photographer stood.

    z is up, the first camera looks along +y (as Blender's view from the front does), and the
    cameras' median distance is `DISTANCE`.

    Args:
        world_from_camera: (N, 4, 4) poses, N at least 1, OpenGL axes.
    """
    places = world_from_camera[:, :3, 3]
    right, top, back = (world_from_camera[:, :3, k] for k in range(3))
    up = upward(right, top)
    # Least squares; of parallel axes the solution nearest to the mean of the cameras.
    across = np.eye(3) - back[:, :, None] * back[:, None]
    middle = places.mean(axis=0)
    wanted = (across @ (places - middle)[:, :, None])[..., 0].sum(axis=0)
    inverse: Floats = np.linalg.pinv(across.sum(axis=0), rcond=1e-6)
    center = middle + inverse @ wanted
    ahead = -back[0] + (back[0] @ up) * up
    if np.linalg.norm(ahead) < 1e-3:  # It looks straight down: its upper edge is ahead.
        ahead = top[0] - (top[0] @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    rotation = np.array([np.cross(ahead, up), ahead, up], dtype=np.float64)
    away = float(np.median(np.linalg.norm(places - center, axis=1)))
    scale = DISTANCE / away if away > 0 else 1.0
    return Similarity(scale, rotation, -scale * rotation @ center)

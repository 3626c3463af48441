"""A light in one sentence, for people."""

from __future__ import annotations

import torch

from pcore.geometry.surfels import Surfels
from pcore.relight.relighting import Relighting


def describe_light(relighting: Relighting, surfels: Surfels) -> str:
    """Say where the most light comes from and how far, how uneven it is, and who has a normal."""
    light = relighting.light
    # Of all ways a surface can face: the best and the worst lit.
    falling = light.irradiance(light.directions)
    x, y, z = (float(one) for one in light.directions[int(falling.argmax())])
    ratio = float(falling.max() / falling.min().clamp_min(1e-3 * falling.max()))
    known = float(surfels.known.to(torch.float32).mean())
    shown = surfels.places[surfels.known]
    size = float((shown.amax(dim=0) - shown.amin(dim=0)).norm()) if len(shown) else 0.0
    nearness = size * light.mean_nearness
    height = float(surfels.heights.median())
    # Beyond that the light on an object varies by a few percent.
    distance = f"{1 / nearness:.1f} times the object's size" if nearness > 0.02 else "far"
    return (
        f"brightest on surfaces that face ({x:.2f}, {y:.2f}, {z:.2f}), {ratio:.1f} times the light "
        f"of the darkest; lamps are {distance} away; "
        f"{100 * known:.0f} % of the points have a normal"
        # Gaussians are the surface themselves.
        + (f", the surface lies {height:.2g} world units above them" if height else "")
    )

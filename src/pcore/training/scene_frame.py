"""The coordinates that networks learn a scene in: its own size and middle, whatever its units."""

from __future__ import annotations

from dataclasses import replace

from pcore.data.scene import Scene
from pcore.model.papr_config import NetworkFrame, PaprConfig

USUAL_RADIUS = 1.3654
"""`Scene.radius` of NeRF-Synthetic's scenes (chair, lego), for which the settings were made."""
_USUAL = 1e-4
"""Scenes so near to the usual one, as a share of it, keep world coordinates, as the original has
them: they train as they always did, and their checkpoints are the original's."""


def network_frame(scene: Scene) -> NetworkFrame | None:
    """Return the frame in which a scene has the usual radius about the origin; None: it is so.

    Raises:
        SceneError: the views do not tell where the object is.
    """
    unit = scene.radius / USUAL_RADIUS
    off = float(scene.center.norm()) / scene.radius
    if abs(unit - 1) < _USUAL and off < _USUAL:
        return None
    x, y, z = scene.center.tolist()
    return NetworkFrame(center=(x, y, z), unit=unit)


def in_frame(config: PaprConfig, frame: NetworkFrame | None) -> PaprConfig:
    """Return settings that were made for a usual scene for one that is so in a frame."""
    if frame is None:
        return config
    cutoff = None if config.cutoff is None else config.cutoff * frame.unit
    return replace(config, frame=frame, cutoff=cutoff)

"""Training near the origin, wherever a scene lies: single precision has no digits left far away.

A training takes a place at the object for the origin, and adds it to what it hands over.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import torch
from torch import Tensor

from pcore.contrib.learned_skinning import Skinning
from pcore.data.scene import Scene, View
from pcore.errors import SceneError
from pcore.gaussians.gaussians import Gaussians
from pcore.geometry.object_region import Region
from pcore.model.papr import Papr
from pcore.model.papr_config import NetworkFrame, PaprConfig
from pcore.training.trained import Trained

_FAR = 16.0
"""Radii of the object from the origin within which single precision keeps 1e-6 of its size."""


def near_origin(scene: Scene) -> tuple[Scene, Tensor | None]:
    """Return a scene as a training takes it, and where its origin (3,) float64 is in the world.

    A scene that is near enough to the origin of the world stays there (None); one whose views do
    not tell where the object is as well: whoever needs that says so.
    """
    try:
        center, radius = scene.center.double(), scene.radius
    except SceneError:
        return scene, None
    if float(center.norm()) <= _FAR * radius:
        return scene, None
    return _moved_scene(scene, -center), center


def moved(places: Tensor, by: Tensor) -> Tensor:
    """Places (..., 3) moved by (3,) float64; rounded once, to their own type."""
    return (places.double() + by.to(places.device)).to(places.dtype)


def _moved_scene(scene: Scene, by: Tensor) -> Scene:
    """A scene's training views, its sparse points and region moved, all in float32."""

    def change(view: View) -> View:
        rounded, exact = view.camera.world_from_camera, view.exact_pose
        if exact is None or not torch.equal(exact.to(rounded), rounded):
            exact = rounded.double()  # Whoever made that camera gave it another pose.
        pose = exact.clone()
        pose[:3, 3] += by
        return replace(view, camera=view.camera.moved(pose.float()), exact_pose=None)

    sparse, region = scene.sparse, scene.region
    return replace(
        scene,
        views={"train": tuple(change(view) for view in scene.split("train"))},
        sparse=sparse and replace(sparse, positions=moved(sparse.positions, by)),
        region=region and moved_region(region, by, torch.float32),
    )


def moved_region(region: Region, by: Tensor, kind: torch.dtype) -> Region:
    """Return a region moved by (3,) float64, as tensors of some type."""
    box = region.box
    return replace(
        region,
        center=(region.center.double() + by).to(kind),
        box=None if box is None else (box.double() + by).to(kind),
    )


def moved_gaussians(gaussians: Gaussians, by: Tensor) -> Gaussians:
    """Return Gaussians moved by (3,) float64."""
    return replace(gaussians, means=moved(gaussians.means, by))


def moved_config(config: PaprConfig, by: Tensor) -> PaprConfig:
    """Return settings of the same networks for a world in which everything is moved by (3,)."""

    def change(center: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (torch.tensor(center, dtype=torch.float64) + by).tolist()
        return x, y, z

    world = NetworkFrame(center=(0.0, 0.0, 0.0), unit=1.0)
    frame = config.frame or world
    frame = replace(frame, center=change(frame.center))
    reference = config.reference
    return replace(
        config,
        frame=None if frame == world else frame,
        reference=reference and replace(reference, center=change(reference.center)),
    )


def moved_trained(found: Trained, by: Tensor) -> Trained:
    """Return networks, points and skinning moved by (3,) float64; surfels are not moved along."""
    papr = like_with(found.papr, moved_config(found.papr.config, by))
    return replace(
        found,
        papr=papr.requires_grad_(False).eval(),
        cloud=replace(found.cloud, positions=moved(found.cloud.positions, by)),
        skinning=None if found.skinning is None else _moved_skinning(found.skinning, by),
        surfels=None,
    )


def like_with(papr: Papr, config: PaprConfig) -> Papr:
    """Return networks with other settings and the same weights, on the same device."""
    with torch.random.fork_rng(devices=[]):  # Its initial weights are drawn and overwritten.
        made = Papr(config).to(next(papr.parameters()).device)
    made.load_state_dict(papr.state_dict())
    return made


def _moved_skinning(skinning: Skinning, by: Tensor) -> Skinning:
    network = copy.deepcopy(skinning.network)
    center = network.get_buffer("center")
    center.copy_(moved(center, by))
    paths = replace(skinning.paths, points=moved(skinning.paths.points, by))
    return replace(skinning, network=network, paths=paths)


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

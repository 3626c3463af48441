"""Automatic masks by a short training: learn the whole room, and draw the object alone.

For captures where colours do not tell object and background apart, or where nothing but a training
tells where the object is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.capture.auto_masks import FoundMasks
from pcore.capture.gaussian_shape import GaussianShape, find_shape
from pcore.data.pictures import to_bytes
from pcore.data.scene import Scene, View
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.training.events import Event, StepReport
from pcore.training.gaussian_config import GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.presets import gaussian_preset
from pcore.training.schedule import Level

_SIDE = 160
"""Longer side, pixels, of the photos that are learned."""
_STEPS, _START = 800, 8000


def trained_masks(
    scene: Scene,
    *,
    steps: int = _STEPS,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[tuple[View, ...], FoundMasks]:
    """Learn Gaussians of small photos, background included, and find the object among them.

    Args:
        scene: photos without masks; its training views alone are learned.
        steps: of the training; 800 take one to two processor minutes.
        progress: told (steps done, steps in all).

    Returns:
        Views, those of training first, and their masks; all agree, since they show one object.

    Raises:
        InputError: nothing stands out of what the cameras look at.
        TrainingError: diverged.
    """
    train = scene.split("train")
    others = [v for name in scene.splits if name != "train" for v in scene.split(name)]

    def listen(event: Event) -> None:
        if progress is not None and isinstance(event, StepReport):
            progress(event.step, event.steps)

    trained = fit_gaussians(scene, _config(train[0].camera, steps), listener=listen)
    shape = find_shape(
        trained.gaussians,
        trained.footprint,
        [_small(view.camera) for view in train],
        torch.Generator().manual_seed(0),
    )
    if shape is None:
        raise InputError(
            f"scene {scene.name}: expected something that stands out of floor and walls where the "
            "cameras look, found nothing; give masks of your own (--masks FOLDER)"
        )
    views = (*train, *others)
    masks = tuple(_mask(shape, view.camera) for view in views)
    return views, FoundMasks(masks=masks, agreement=(1.0,) * len(views))


def _config(camera: Camera, steps: int) -> GaussianConfig:
    preset, by = gaussian_preset("tiny"), _reduction(camera)
    return replace(
        preset,
        steps=steps,
        points=_START,
        # The room for Gaussians is that of the whole photos, and shrinks with them.
        density=replace(preset.density, limit=by * preset.density.limit),
        levels=(Level(until=1.0, reduction=by),) if by > 1 else None,
        validate_every=steps,
        save_every=steps,
    )


def _reduction(camera: Camera) -> int:
    return max(1, round(max(camera.width, camera.height) / _SIDE))


def _small(camera: Camera) -> Camera:
    by = _reduction(camera)
    return camera.resized(max(1, round(camera.width / by)), max(1, round(camera.height / by)))


def _mask(shape: GaussianShape, camera: Camera) -> Tensor:
    """A mask in the size of its photo, drawn small and enlarged."""
    mask = shape.mask(_small(camera))
    size = (camera.height, camera.width)
    if mask.shape != size:
        mask = F.interpolate(mask[None, None], size, mode="bicubic")[0, 0]
    return to_bytes(mask)

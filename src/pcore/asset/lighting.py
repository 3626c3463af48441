"""The light of an object's photos: estimated, and kept where the object has a folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import neural_points_of
from pcore.data.scene import Scene, check_images
from pcore.errors import InputError
from pcore.relight.estimate import fit_light
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.render.surfel_fit import Observed, observe
from pcore.training.in_folder import RunOptions


def estimate_light(
    asset: Asset,
    scene: Scene,
    *,
    observed: Observed | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Asset:
    """Estimate the light of an object's photos; written beside it where it has a folder.

    Where nobody has estimated the surface over its points, as in an imported run, that is done as
    well, and kept in the model file. The normals of Gaussians are estimated with it, every time.

        asset = estimate_light(asset, asset.scene())

    Args:
        asset: the object; its device does the work.
        scene: the one it was trained on; only training views are used.
        observed: what the views say about the points, where that is known (`Trained.observed`).
        progress: told (views seen, views in all).

    Raises:
        InputError: too few points have a normal that the views agree on.
        SceneError: an image is damaged.
        OSError: the file cannot be written.
    """
    views = scene.split("train")
    check_images(views)
    if isinstance(asset.content, GaussianContent):
        made = asset.content.with_light(views, progress=progress)
        if asset.record.path is not None:
            made.save_gaussians(asset.path, asset.provenance)
            if made.light is not None:
                save_light(asset.path / LIGHT_FILE, made.light)
        return replace(asset, content=made)
    content = neural_points_of(asset, "light")
    if observed is None:
        observed = observe(content.papr, content.cloud, views, progress=progress)
    if content.surfels is None:
        content = replace(content, surfels=observed.surfels(content.cloud))
        asset = replace(asset, content=content)
        if asset.record.path is not None:
            # Before the light, which may fail: too few points may have a normal for it.
            content.save_model(asset.path, asset.provenance)
    light = fit_light(observed, content.cloud.positions)
    if asset.record.path is not None:
        save_light(asset.path / LIGHT_FILE, light)
    return replace(asset, content=replace(content, read_light=lambda: light))


def lit(asset: Asset, scene: Scene, options: RunOptions, observed: Observed | None = None) -> Asset:
    """Estimate the light where that is wished and possible; else the note says why it is not."""
    if options.light:
        try:
            return estimate_light(asset, scene, observed=observed)
        except (InputError, OSError) as error:
            options.note(f"note: {error}")
    return asset

"""Make assets: train one on photos, fine-tune it, estimate its light; what the commands do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.gaussian_training import (
    gaussian_plan,
    keep_light,
    train_gaussians,
    tune_gaussians,
)
from pcore.asset.run_options import RunOptions
from pcore.asset.saving import asset_of, load, neural_points_of
from pcore.data.scene import Scene, check_images
from pcore.errors import InputError
from pcore.files.records import to_dict
from pcore.files.run_folder import RunFolder
from pcore.files.run_record import RunRecord, of_scene, relative
from pcore.relight.estimate import fit_light
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.render.surfel_fit import Observed, observe
from pcore.training import presets
from pcore.training.config import FinetuneConfig, PresetName, PretrainConfig
from pcore.training.events import Listener, silent
from pcore.training.finetune import finetune as run_finetuning
from pcore.training.gaussian_config import GaussianConfig, GaussianFinetuneConfig
from pcore.training.in_folder import FolderPlan, disk_space, train_in_folder
from pcore.training.locate import locate
from pcore.training.presets import PretrainName
from pcore.training.pretrain import pretrain
from pcore.training.trained import Trained

FinetuneSettings = FinetuneConfig | GaussianFinetuneConfig
"""Settings of P-CORE for either kind of object."""


def train(
    scene: Scene,
    settings: PretrainConfig | PretrainName | GaussianConfig | Literal["gaussians"] = "gaussians",
    *,
    folder: Path | str | None = None,
    listener: Listener = silent,
    device: str = "cpu",
    options: RunOptions | None = None,
) -> Asset:
    """Learn an object and its light from the training views of a scene, as `pcore train` does.

        asset = pcore.train(pcore.load_scene("photos"), folder="runs/toy")

    Args:
        scene: its `train` split is used, nothing else; every `hold_out`-th view only validates.
        settings: "gaussians" or a `GaussianConfig`: an object of Gaussians; settings of PAPR, or
            the name of a preset of it: one of neural points.
        folder: new or empty folder for the run; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: where to train, and then to draw: "cpu", "cuda", ...
        options: light, resuming, logs.

    Raises:
        InputError: the folder is in use, or settings that do not fit the scene.
        WeightsError: LPIPS was asked for and its weights are missing.
        TrainingError: diverged, cannot be compiled or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    chosen = options or RunOptions()
    scene = scene if scene.region is not None else locate(scene).scene
    if settings == "gaussians":
        settings = presets.gaussian_preset("tiny")
    if isinstance(settings, GaussianConfig):
        plan = gaussian_plan(
            scene,
            settings,
            folder,
            preset=chosen.preset,
            resume=chosen.resume,
            tensorboard=chosen.tensorboard,
            note=chosen.note,
        )
        asset, learned = train_gaussians(
            scene, settings, plan, listener, device, keep=folder is not None
        )
        # Whoever was killed after the last save and before the light was has none yet.
        return _lit(asset, scene, chosen) if learned or asset.light is None else asset
    config = presets.preset(settings) if isinstance(settings, str) else settings
    name = settings if isinstance(settings, str) else presets.preset_of(config)
    limit = config.grow.limit if config.grow else config.points
    record = RunRecord(
        path=None if folder is None else Path(folder),
        stage="pretrain",
        config={
            "preset": chosen.preset or name,
            **of_scene(scene, None if folder is None else Path(folder)),
            "pretrain": to_dict(config),
        },
    )

    def run(out: RunFolder | None, tell: Listener) -> Trained:
        return pretrain(
            scene, config, folder=out, listener=tell, device=device, compiled=chosen.compiled
        )

    needed = disk_space(config.model, max(limit, config.points))
    return _made(scene, record, run, listener, device, needed, chosen)


def finetune(
    asset: Asset,
    scene: Scene,
    settings: FinetuneSettings | PresetName | None = None,
    *,
    folder: Path | str | None = None,
    listener: Listener = silent,
    device: str = "cpu",
    options: RunOptions | None = None,
) -> Asset:
    """Fine-tune an object with random deformations (P-CORE), as `pcore finetune` does.

        tuned = pcore.finetune(asset, asset.scene(), folder="runs/toy-pcore")

    Args:
        asset: the pre-trained object; left as it is.
        scene: the one it was trained on; only training views are used.
        settings: losses and schedule, or the name of a preset; None: see `finetune_settings`.
        folder: new or empty folder for the run; None keeps everything in memory.
        listener: told of steps, validations, saves.
        device: where to train, and then to draw: "cpu", "cuda", ...
        options: light, resuming, logs.

    Raises:
        InputError: the folder is in use, fewer points than the skinning wants anchors, or settings
            of another kind of object.
        WeightsError: LPIPS was asked for and its weights are missing.
        TrainingError: diverged, cannot be compiled or cannot write.
        KeyboardInterrupt: Ctrl-C, after saving.
    """
    chosen = options or RunOptions()
    known = settings if isinstance(settings, str) else None
    name, config = finetune_settings(asset, known)
    if settings is not None and not isinstance(settings, str):
        config = settings
    path = None if folder is None else Path(folder)
    about = {
        **_base_of(asset, path),
        "preset": chosen.preset or name,
        **of_scene(scene, path),
    }
    if isinstance(config, GaussianFinetuneConfig):
        tuned, learned = tune_gaussians(
            asset, scene, config, path, listener, device, about=about, options=chosen
        )
        return _lit(tuned, scene, chosen) if learned else tuned
    content = neural_points_of(asset, "finetune")
    record = RunRecord(path=path, stage="finetune", config={**about, "finetune": to_dict(config)})
    base = Trained(papr=content.papr, cloud=content.cloud, step=asset.provenance.step)

    def run(out: RunFolder | None, tell: Listener) -> Trained:
        return run_finetuning(
            scene, base, config, folder=out, listener=tell, device=device, compiled=chosen.compiled
        )

    needed = disk_space(content.papr.config, len(content.cloud))
    return _made(scene, record, run, listener, device, needed, chosen)


def finetune_settings(
    asset: Asset, name: PresetName | None = None
) -> tuple[PresetName, FinetuneSettings]:
    """Name and settings of fine-tuning for an object of either kind; its background stays.

    Args:
        asset: says which preset it was trained with; "paper" where that is not known.
        name: of another preset.
    """
    known: dict[Any, PresetName] = {"tiny": "tiny", "fast": "fast"}
    chosen = name or known.get(str(asset.record.config.get("preset")), "paper")
    if isinstance(asset.content, GaussianContent):
        black = asset.content.background == (0.0, 0.0, 0.0)
        return chosen, replace(
            presets.gaussian_finetune_preset(chosen), background="black" if black else "random"
        )
    content = neural_points_of(asset, "finetune")
    black = content.papr.config.background == (0.0, 0.0, 0.0)
    return chosen, replace(
        presets.finetune_preset(chosen), background="black" if black else "white"
    )


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
        return keep_light(asset, asset.content.with_light(views, progress=progress))
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


def _lit(
    asset: Asset, scene: Scene, options: RunOptions, observed: Observed | None = None
) -> Asset:
    """Estimate the light where that is wished and possible; else the note says why it is not."""
    if options.light:
        try:
            return estimate_light(asset, scene, observed=observed)
        except (InputError, OSError) as error:
            options.note(f"note: {error}")
    return asset


def _base_of(asset: Asset, folder: Path | None) -> dict[str, str]:
    """What a record says of the run that fine-tuning began with."""
    if asset.record.path is None:
        return {}
    began = asset.path.resolve()
    return {"base": str(began) if folder is None else relative(began, folder)}


def _made(
    scene: Scene,
    record: RunRecord,
    run: Callable[[RunFolder | None, Listener], Trained],
    listener: Listener,
    device: str,
    needed: int,
    options: RunOptions,
) -> Asset:
    """Train as `record` says and hand over the asset; a finished run is left as it is."""
    place = scene.name if scene.folder is None else scene.folder.resolve()
    if record.path is None:
        trained = run(None, listener)
        asset = _in_memory(trained, scene, record, str(place))
    else:
        plan = FolderPlan(
            path=record.path,
            stage=record.stage,
            scene=place,
            config=record.config,
            resume=options.resume,
            tensorboard=options.tensorboard,
            needed=needed,
            note=options.note,
        )
        trained = train_in_folder(plan, run, listener)
        asset = load(record.path, device=device)
        if trained is None:
            # Whoever was killed after the last save and before the light was has none yet.
            return _lit(asset, scene, options) if asset.light is None else asset
    return _lit(asset, scene, options, trained.observed)


def _in_memory(trained: Trained, scene: Scene, record: RunRecord, place: str) -> Asset:
    """The same asset as one that is read from a folder."""
    asset = asset_of(
        trained.papr,
        trained.cloud,
        scene=scene.name,
        stage=record.stage,
        step=trained.step,
        surfels=trained.surfels,
        skinning=trained.skinning,
    )
    return replace(asset, record=replace(record, scene=place))

"""Make assets: train one on photos, fine-tune it; what the commands do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.job import Job, gaussian_space
from pcore.asset.saving import neural_points_of
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.files.records import from_dict, to_dict
from pcore.files.run_folder import RunFolder
from pcore.files.run_record import RunRecord, of_scene, relative
from pcore.training import presets
from pcore.training.config import FinetuneConfig, PresetName, PretrainConfig
from pcore.training.events import Listener, silent
from pcore.training.finetune import finetune as run_finetuning
from pcore.training.gaussian_config import GaussianConfig, GaussianFinetuneConfig
from pcore.training.gaussian_finetune import finetune_gaussians
from pcore.training.gaussian_fit import fit_gaussians
from pcore.training.in_folder import RunOptions, disk_space
from pcore.training.locate import locate
from pcore.training.presets import PretrainName
from pcore.training.pretrain import pretrain
from pcore.training.trainable_gaussians import TrainedGaussians
from pcore.training.trained import Trained

FinetuneSettings = FinetuneConfig | GaussianFinetuneConfig
"""Settings of P-CORE for either kind of object."""
Settings = PretrainConfig | GaussianConfig | FinetuneSettings
"""Settings of any training."""


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
    path = None if folder is None else Path(folder)
    scene = scene if scene.region is not None else locate(scene).scene
    if settings == "gaussians":
        settings = presets.gaussian_preset("tiny")
    if isinstance(settings, GaussianConfig):
        job = _gaussian_training(scene, settings, path, device, chosen)
        return job.made(scene, listener, device, chosen)
    config = presets.preset(settings) if isinstance(settings, str) else settings
    name = settings if isinstance(settings, str) else presets.preset_of(config)
    limit = config.grow.limit if config.grow else config.points
    about = {
        "preset": chosen.preset or name,
        **of_scene(scene, path),
        "pretrain": to_dict(config),
    }

    def learn(out: RunFolder | None, tell: Listener) -> Trained:
        return pretrain(
            scene, config, folder=out, listener=tell, device=device, compiled=chosen.compiled
        )

    job = Job(
        record=RunRecord(path=path, stage="pretrain", config=about),
        learn=learn,
        needed=disk_space(config.model, max(limit, config.points)),
    )
    return job.made(scene, listener, device, chosen)


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
    path = None if folder is None else Path(folder)
    known = settings if isinstance(settings, str) else None
    name, config = finetune_settings(asset, known)
    if settings is not None and not isinstance(settings, str):
        config = settings
    about = {
        **_base_of(asset, path),
        "preset": chosen.preset or name,
        **of_scene(scene, path),
        "finetune": to_dict(config),
    }
    if isinstance(config, GaussianFinetuneConfig):
        job = _gaussian_tuning(asset, scene, config, path, device, about)
        return job.made(scene, listener, device, chosen)
    content = neural_points_of(asset, "finetune")
    base = Trained(papr=content.papr, cloud=content.cloud, step=asset.provenance.step)

    def learn(out: RunFolder | None, tell: Listener) -> Trained:
        return run_finetuning(
            scene, base, config, folder=out, listener=tell, device=device, compiled=chosen.compiled
        )

    job = Job(
        record=RunRecord(path=path, stage="finetune", config=about),
        learn=learn,
        needed=disk_space(content.papr.config, len(content.cloud)),
    )
    return job.made(scene, listener, device, chosen)


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


def settings_of(record: RunRecord) -> Settings:
    """See `Asset.settings`."""
    config = record.config
    tuned = GaussianFinetuneConfig if config.get("model") == "gaussians" else FinetuneConfig
    kinds = {"gaussians": GaussianConfig, "pretrain": PretrainConfig, "finetune": tuned}
    for stage, kind in kinds.items():
        if stage in config:
            where = "settings" if record.path is None else f"{record.path}: run.json"
            return from_dict(kind, config[stage], where=f"{where}: {stage}")
    raise InputError(
        "settings: expected an object that pcore trained, got one without settings on record, as "
        "after an import; give your own"
    )


def _gaussian_training(
    scene: Scene, config: GaussianConfig, path: Path | None, device: str, options: RunOptions
) -> Job[TrainedGaussians]:
    about = {
        "model": "gaussians",
        "preset": options.preset,
        **of_scene(scene, path),
        "gaussians": to_dict(config),
    }

    def learn(out: RunFolder | None, tell: Listener) -> TrainedGaussians:
        return fit_gaussians(scene, config, folder=out, listener=tell, device=device)

    return Job(
        record=RunRecord(path=path, stage="pretrain", config=about),
        learn=learn,
        needed=gaussian_space(max(config.points, config.density.limit), config.degree),
    )


def _gaussian_tuning(
    asset: Asset,
    scene: Scene,
    config: GaussianFinetuneConfig,
    path: Path | None,
    device: str,
    about: dict[str, Any],
) -> Job[TrainedGaussians]:
    content = asset.content
    assert isinstance(content, GaussianContent), "the caller tells objects apart"
    base = TrainedGaussians(
        gaussians=content.gaussians,
        footprint=content.footprint,
        background=content.background,
        step=asset.provenance.step,
    )

    def learn(out: RunFolder | None, tell: Listener) -> TrainedGaussians:
        return finetune_gaussians(scene, base, config, folder=out, listener=tell, device=device)

    return Job(
        record=RunRecord(path=path, stage="finetune", config={"model": "gaussians", **about}),
        learn=learn,
        needed=gaussian_space(len(base.gaussians), base.gaussians.degree),
    )


def _base_of(asset: Asset, folder: Path | None) -> dict[str, str]:
    """What a record says of the run that fine-tuning began with."""
    if asset.record.path is None:
        return {}
    began = asset.path.resolve()
    return {"base": str(began) if folder is None else relative(began, folder)}

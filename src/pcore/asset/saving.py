"""Assets in folders: reading whatever lies there, and writing what every command reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pcore.asset.asset import WHITE, Asset
from pcore.asset.content import Content
from pcore.asset.gaussian_content import GaussianContent, read_gaussians
from pcore.asset.neural_points import NeuralPoints, read_neural_points
from pcore.contrib.learned_skinning import Skinning
from pcore.errors import InputError
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.files.headers import name_in_folder
from pcore.files.model_file import MODEL_FILE
from pcore.files.provenance import Provenance, Stage, provenance_of
from pcore.files.run_folder import RunFolder, write_guard
from pcore.files.run_record import RunRecord, relative
from pcore.files.skinning_file import SKINNING_FILE, load_skinning
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.relight.relighting import Relighting

Reader = Callable[[Path, str], tuple[Content[Any], Provenance]]

READERS: dict[str, Reader] = {MODEL_FILE: read_neural_points, GAUSSIANS_FILE: read_gaussians}
"""Kinds of objects by the file that a folder of one holds; the first is expected where none is."""


def load(path: Path | str, *, device: str = "cpu") -> Asset:
    """Open a trained object: networks, canonical points, light and learned weights.

        asset = pcore.load("runs/toy")

    Args:
        path: folder of a run, or a bare model file, which has neither light nor weights beside it.
        device: where its pictures are computed: "cpu", "cuda", ...

    Raises:
        CheckpointError: there is neither, or it is damaged. A light or weights that are damaged
            raise when they are first needed.
    """
    path = Path(path)
    # A model file that is not there is more likely a folder that is not there.
    bare = path.is_file() or path.suffix == Path(MODEL_FILE).suffix
    stored = None if bare else RunRecord.read(path)
    content, provenance = _reader_for(path)(path, device)
    points, weights = content.points, path / SKINNING_FILE
    return Asset(
        content=content,
        provenance=provenance,
        record=stored or RunRecord(stage=provenance.stage),
        read_skinning=(lambda: load_skinning(weights, points)) if weights.is_file() else None,
    )


def _reader_for(path: Path) -> Reader:
    if path.is_file():
        return READERS.get(name_in_folder(path) or "", READERS[MODEL_FILE])
    known = [name for name in READERS if (path / name).is_file()]
    return READERS[known[0]] if known else READERS[MODEL_FILE]


def asset_of(
    learned: Papr | Gaussians,
    cloud: PointCloud | None = None,
    *,
    like: Asset | None = None,
    scene: str = "",
    stage: Stage = "pretrain",
    step: int = 0,
    surfels: Surfels | None = None,
    light: Relighting | None = None,
    skinning: Skinning | None = None,
) -> Asset:
    """Make an asset of what is in memory: networks and points, or Gaussians.

        asset = asset_of(papr, cloud)
        asset = asset_of(gaussians, like=asset)  # after a training loop of your own

    Args:
        learned: the networks, or the Gaussians in world units; used as they are.
        cloud: canonical points of networks, world units; autograd follows it where it asks for
            that. None takes those of `like`.
        like: the asset that it was learned from: its scene, settings, stage, background, and how
            its Gaussians meet pixels are kept; its scores, light and surface are not.
        scene: name of the scene; without `like`.
        stage: what made the weights; without `like`.
        step: steps of that stage.
        surfels: the surface over the points at rest.
        light: of the photos.
        skinning: weights that were learned for edits by anchors.

    Raises:
        InputError: networks without points, or `like` an object of another kind.
    """
    record = RunRecord(stage=stage)
    if like is not None:
        scene, stage = like.provenance.scene, like.provenance.stage
        record = replace(like.record.without_folder(), notes={})
    read_light = light and (lambda: light)
    if isinstance(learned, Gaussians):
        content = _gaussian_content(learned, like)
        color = content.background
    else:
        own = None if like is None else neural_points_of(like, "asset of networks").cloud
        points = own if cloud is None else cloud
        if points is None:
            raise InputError("asset of networks: expected the canonical points too, got none")
        content = NeuralPoints(
            papr=learned,
            cloud=points.to("cpu"),
            surfels=None if surfels is None else surfels.to("cpu"),
        )
        color = learned.config.background
    came = provenance_of(content.points, color, scene=scene, stage=stage, step=step)
    return Asset(
        content=replace(content, read_light=read_light),
        provenance=came,
        record=record,
        read_skinning=skinning and (lambda: skinning),
    )


def _gaussian_content(gaussians: Gaussians, like: Asset | None) -> GaussianContent:
    """What draws Gaussians: as an asset does, or as a trainer of ours begins."""
    if like is None:
        return GaussianContent(gaussians=gaussians, footprint=Footprint(), background=WHITE)
    if not isinstance(like.content, GaussianContent):
        raise InputError(
            "asset of Gaussians: expected `like` to be one of Gaussians, got "
            f"{type(like.content).__name__}"
        )
    return replace(like.content, gaussians=gaussians, normals=None)


def save_asset(asset: Asset, folder: Path) -> Asset:
    """See `Asset.save`."""
    record = asset.record
    config = dict(record.config)
    for name, place in (("base", record.base), ("masks", record.masks)):
        if place is not None:
            config[name] = relative(place, folder)
    scene = record.scene if record.scene_folder is None else relative(record.scene_folder, folder)
    with RunFolder.create(folder, stage=record.stage, scene=scene, config=config) as run:
        with write_guard(run.model):
            asset.content.save(folder, asset.provenance)
        if asset.skinning is not None:
            run.save_skinning(asset.skinning)
        run.update(**{**record.notes, "status": "finished", "step": asset.provenance.step})
    return replace(asset, record=RunRecord.read(folder))


def neural_points_of(asset: Asset, what: str) -> NeuralPoints:
    """Networks and points of an asset, for what works with no other kind of object.

    Args:
        asset: the object.
        what: for messages, what wants to work with it.

    Raises:
        InputError: it is of another kind.
    """
    if not isinstance(asset.content, NeuralPoints):
        raise InputError(
            f"{what}: expected an object that `pcore train` made of photos (neural points), got "
            f"{type(asset.content).__name__}"
        )
    return asset.content

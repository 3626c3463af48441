"""Who is compared: runs that were given, and rivals that are trained."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import LightName, RaysName
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.neural_points import NeuralPoints
from pcore.data.scene import Scene
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.contest import Contestant, Cost, Entry, Setting
from pcore.evaluation.gaussian_method import (
    GaussianMethod,
    Rule,
    gaussian_content,
    node_rule,
    turned_rule,
)
from pcore.evaluation.methods import apart, label_of, methods_of, never_seen
from pcore.rivals.kept import Spent

MethodName = Literal[
    "papr",
    "aware",
    "light",
    "3dgs-fixed",
    "3dgs-rotation",
    "3dgs-affine",
    "3dgs-light",
    "2dgs-affine",
    "2dgs-light",
    "sc-gs",
    "mani-gs",
    "voxels",
    "papr-time",
    "motion",
]
METHODS: tuple[MethodName, ...] = get_args(MethodName)
RULES: dict[MethodName, str] = {
    "3dgs-fixed": "3DGS (ours), covariances as trained",
    "3dgs-rotation": "3DGS (ours), local rotations",
    "3dgs-affine": "3DGS (ours), local affine covariances",
    "3dgs-light": "3DGS (ours), affine + light",
    "2dgs-affine": "2DGS (ours), affine tangents",
    "2dgs-light": "2DGS (ours), affine + light",
    "sc-gs": "3DGS (ours), SC-GS's edit rule",
}
"""Rules for Gaussians: who trains them, and whose rule it is."""
_WAYS: tuple[tuple[str, RaysName, LightName], ...] = (
    ("PAPR", "plain", "baked"),
    ("aware", "aware", "baked"),
    ("aware + light", "aware", "still"),
)
"""To draw neural points: name, rays, light."""
FLAT: tuple[MethodName, ...] = ("2dgs-affine", "2dgs-light")
"""Those for flat Gaussians; the others are for those in space."""

_POINTS = "a run of points (`pcore train --model papr`)"
_NEEDED: dict[MethodName, str] = {
    "papr": _POINTS,
    "aware": _POINTS,
    "light": f"{_POINTS} with a light (`pcore light`)",
    "motion": f"{_POINTS} before `pcore finetune`",
    "voxels": "--settings time",
    "papr-time": "--settings time",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """A run that was trained before.

    Attributes:
        asset: on white.
        stamp: tells it from other runs in the same folder.
    """

    asset: Asset
    stamp: str


def given_entries(
    runs: Sequence[Given],
    scene: Scene,
    wanted: Sequence[MethodName],
) -> list[Entry]:
    """Entries of runs; those that differ in their seed alone are one method of several seeds.

    Args:
        runs: from `open_subject`.
        scene: theirs; its training views say what was never seen.
        wanted: names of methods.
    """
    found: list[Entry] = []
    for run, alike in zip(runs, suffixes(runs), strict=True):
        asset = run.asset
        if isinstance(asset.content, GaussianContent):
            tuned = ", after P-CORE on Gaussians" * (asset.record.stage == "finetune")
            found += rule_entries(
                "given",
                seed_of(asset),
                run.stamp,
                [name for name in wanted if (name in FLAT) == _flat(asset)],
                lambda asset=asset: (asset, spent_on(asset)),
                scene,
                suffix=tuned + alike,
            )
        else:
            found += _point_entries(run, scene, wanted, alike)
    return found


def needed(name: MethodName) -> str:
    """What a method cannot be compared without."""
    return _NEEDED.get(name, "a run of Gaussians, or --settings and --seeds to train some")


def rule_entries(
    setting: Setting,
    seed: int,
    stamp: object,
    wanted: Sequence[MethodName],
    make: Callable[[], tuple[Asset, Spent | None]],
    scene: Scene,
    *,
    suffix: str = "",
) -> list[Entry]:
    """Entries of all wanted rules for one set of Gaussians, which is trained at most once."""

    def contestant(key: MethodName, name: str) -> Contestant:
        asset, spent = make()
        cost = cost_of(asset, spent)
        unseen = never_seen(asset.points, scene)
        if key in ("3dgs-fixed", "3dgs-affine", "3dgs-light", *FLAT):
            method = AssetMethod(
                name=name,
                asset=asset,
                rays="plain" if key == "3dgs-fixed" else "aware",
                light="still" if key in ("3dgs-light", "2dgs-light") else "baked",
                unseen=unseen,
            )
            return Contestant(method=method, cost=cost)
        rule: Rule = turned_rule(asset) if key == "3dgs-rotation" else node_rule(asset, seed=seed)
        content = gaussian_content(asset)
        method = GaussianMethod(name=name, content=content, rule=rule, unseen=unseen)
        return Contestant(method=method, cost=cost)

    return [
        Entry(
            name=RULES[key] + suffix,
            setting=setting,
            seed=seed,
            stamp=stamp,
            make=lambda key=key: contestant(key, RULES[key] + suffix),
            learns=setting != "given",
        )
        for key in RULES
        if key in wanted
    ]


def point_entries(
    setting: Setting,
    seed: int,
    stamp: object,
    make: Callable[[], tuple[Asset, Spent | None]],
    scene: Scene,
) -> list[Entry]:
    """Entries of all ways to draw neural points, which are trained at most once."""

    def contestant(name: str, rays: RaysName, light: LightName) -> Contestant:
        asset, spent = make()
        unseen = never_seen(asset.points, scene)
        method = AssetMethod(name=name, asset=asset, rays=rays, light=light, unseen=unseen)
        return Contestant(method=method, cost=cost_of(asset, spent))

    return [
        Entry(
            name=way[0],
            setting=setting,
            seed=seed,
            stamp=stamp,
            make=lambda way=way: contestant(*way),
        )
        for way in _WAYS
    ]


def cost_of(asset: Asset, spent: Spent | None) -> Cost:
    """What an object took: its training, and numbers that were learned."""
    return Cost(
        seconds=None if spent is None else spent.seconds,
        primitives=len(asset),
        parameters=_parameters(asset),
        megabytes=None if spent is None else spent.megabytes,
    )


def seed_of(asset: Asset) -> int:
    """Seed of its training; 0 where that is not on record."""
    for stage in ("pretrain", "gaussians", "finetune"):
        seed = dict(asset.record.config.get(stage) or {}).get("seed")
        if isinstance(seed, int):
            return seed
    return 0


def _point_entries(
    run: Given, scene: Scene, wanted: Sequence[MethodName], alike: str
) -> list[Entry]:
    """Neural points: plain rays, aware rays, and those with a light."""
    asset = run.asset
    entries: list[Entry] = []
    for method in methods_of([asset], scene, rays="both", light=None):
        key: MethodName = "papr" if method.rays == "plain" else "aware"
        key = "light" if method.light == "still" else key
        if key in wanted:
            named = replace(method, name=method.name + alike)
            contestant = Contestant(method=named, cost=cost_of(asset, spent_on(asset)))
            entries.append(
                Entry(
                    name=named.name,
                    setting="given",
                    seed=seed_of(asset),
                    stamp=run.stamp,
                    make=lambda contestant=contestant: contestant,
                )
            )
    return entries


def suffixes(runs: Sequence[Given]) -> list[str]:
    """What tells runs of one label apart: nothing if their seeds do, else their folders."""
    keys = [
        (type(run.asset.content).__name__, _flat(run.asset), label_of(run.asset)) for run in runs
    ]
    names: list[str] = []
    for run, key in zip(runs, keys, strict=True):
        same = [other for other, one in zip(runs, keys, strict=True) if one == key]
        seeds = {seed_of(other.asset) for other in same}
        settings = {_settings(other.asset) for other in same}
        told = len(same) == 1 or (len(seeds) == len(same) and len(settings) == 1)
        names.append("" if told else f" ({apart(run.asset, [one.asset for one in same])})")
    return names


def _flat(asset: Asset) -> bool:
    return isinstance(asset.content, GaussianContent) and asset.content.footprint.flat


def _settings(asset: Asset) -> str:
    """Settings of a training without its seed and base, as text."""
    config = {key: value for key, value in asset.record.config.items() if key != "base"}
    for stage in ("pretrain", "gaussians", "finetune"):
        if isinstance(config.get(stage), dict):
            config[stage] = {**config[stage], "seed": None}
    return json.dumps(config, sort_keys=True)


def _parameters(asset: Asset) -> int:
    content = asset.content
    if isinstance(content, NeuralPoints):
        cloud = content.cloud
        learned = [*content.papr.parameters(), cloud.positions, cloud.features, cloud.influence]
        return sum(one.numel() for one in learned)
    gaussians = gaussian_content(asset).gaussians
    tensors: list[Tensor] = []
    gaussians.each(lambda tensor: tensors.append(tensor) or tensor)
    return sum(one.numel() for one in tensors)


def spent_on(asset: Asset) -> Spent | None:
    """Seconds that are on record of a run's training."""
    found = asset.record.seconds
    return None if found is None else Spent(seconds=found, megabytes=None)


def stamp_of_run(path: Path) -> str:
    """Tells a run from others that were in its folder: its files' sizes and times."""
    names = sorted(path.glob("*.safetensors"))
    parts = [[one.name, one.stat().st_size, one.stat().st_mtime_ns] for one in names]
    return json.dumps([str(path.resolve()), parts])

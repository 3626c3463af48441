"""The paper's skinning table on the six true motions of the evaluation objects.

    python -m benchmarks.skinning DATA RUNS [--joint NAME ...] [--views N] [--rays plain|aware]
        [--lpips FOLDER] [--json FILE]

DATA holds `deformed/{knight,robot}`, RUNS holds `knight`, `robot` and, tuned by `pcore finetune`,
`knight-pcore`, `robot-pcore`. Anchors follow the true mesh; their rotations are estimated from
their places, as at edit time. Everything else is ours. The row `true motion` carries every learned
point with the mesh: no skinning can be better than that on average.

With `--joint nbs`, RUNS holds `knight-nbs` and `robot-nbs` as well, made by `pcore finetune RUN
--skinning`: their weights are scored in the pictures of the pre-trained run (without
self-supervision of the renderer), of `-pcore` (with it), and of the renderer that learned with
them ("renderer of nbs", beside the true motion as it shows that).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import pcore
from benchmarks.surface_samples import load_samples
from pcore.contrib.learned_skinning import SkinningConfig, untrained_skinning
from pcore.contrib.skinning_fit import SkinningFitConfig, fit_skinning, skinning_error
from pcore.deform.anchor_distance import (
    PathDistance,
    StraightDistance,
    anchor_spacing,
    distance_weigher,
    path_distance,
)
from pcore.deform.jacobian import estimated_maps
from pcore.deform.sampler import DeformationRanges, sample_deformation
from pcore.deform.skinning import Weigher, skin
from pcore.editing.anchors import SIGMA, anchor_graph, pose_from_places
from pcore.evaluation.ground_truth import DeformedTruth
from pcore.evaluation.protocol import STANDARD, Perceptual, load_perceptual, measure
from pcore.evaluation.states import State, open_states
from pcore.geometry.farthest_points import ANCHORS, farthest_points
from pcore.metrics.point_metrics import compare_clouds

MOTIONS = {"knight": ("run", "cheer", "sit"), "robot": ("run", "wave", "dance")}
TRUE = "true motion"
COLUMNS = {
    "foreground_psnr": "PSNR, object",
    "psnr": "PSNR",
    "ssim": "SSIM",
    "lpips_alex": "LPIPS",
    "chamfer": "CD",
    "emd": "EMD",
    "f_01": "F 0.01",
    "f_02": "F 0.02",
    "surface_chamfer": "CD, surface",
    "surface_f_01": "F 0.01, surface",
    "surface_f_02": "F 0.02, surface",
    "error": "error",
}


@dataclass(frozen=True, kw_only=True)
class Row:
    """Scores of one method in one state of one run."""

    run: str
    state: str
    method: str
    scores: Mapping[str, float]
    images: Mapping[str, Mapping[str, float | None]]
    """Of every picture, by the name of its view."""


def weighers(distance: PathDistance, points: Tensor, steps: int) -> dict[str, Weigher]:
    """The methods of the table; the first is the baseline of the paper."""
    straight = StraightDistance(anchors=distance.anchors)
    spacing = anchor_spacing(distance.between)
    methods: dict[str, Weigher] = {
        "RBF, sigma 1": distance_weigher(straight, sigma=1.0),
        "graph RBF, sigma 1": distance_weigher(distance, sigma=1.0),
        "RBF, sigma 0.33 s": distance_weigher(straight, sigma=SIGMA * spacing),
        "graph RBF, sigma 0.33 s": distance_weigher(distance, sigma=SIGMA * spacing),
    }
    learned = {
        "NBS as in the paper": SkinningConfig(along_cloud=False, start_sigma=None),
        "NBS": SkinningConfig(),
    }
    for name, config in learned.items():
        began = time.perf_counter()
        start = untrained_skinning(distance, config)
        methods[name] = fit_skinning(start, points, SkinningFitConfig(steps=steps))
        print(f"  {name}: fitted in {time.perf_counter() - began:.0f} s", flush=True)
    return methods


def held_out(points: Tensor, anchors: Tensor, methods: Mapping[str, Weigher]) -> None:
    """Print the error on random deformations that no fit has seen."""
    generator = torch.Generator().manual_seed(4711)
    lower, upper = points.amin(dim=0), points.amax(dim=0)
    fields = [
        sample_deformation(generator, lower, upper, points, DeformationRanges()) for _ in range(40)
    ]
    for name, weigh in methods.items():
        error = skinning_error(points, weigh(points), anchors, fields)
        print(f"  held-out random deformations, {name}: {error:.4f}", flush=True)


def picture_scores(
    asset: pcore.Asset,
    moved: pcore.MovedPoints,
    state: State,
    views: int,
    perceptual: Perceptual | None,
) -> dict[str, dict[str, float | None]]:
    """Image scores of an object in evenly chosen test views, its light baked in."""
    rays = "plain" if moved.local_maps is None else "aware"
    posed = asset.pose(moved, rays=rays, light="baked")
    chosen = np.unique(np.linspace(0, len(state.shots) - 1, views).round().astype(int))
    rows: dict[str, dict[str, float | None]] = {}
    for index in chosen:
        shot = state.shots[index]
        picture = asset.render(posed, shot.camera)
        rows[shot.view.name] = measure(STANDARD, picture.rgb, shot.view.rgba(), perceptual).row()
    return rows


def means(images: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Means over pictures of what all of them have."""
    columns = {name: [row[name] for row in images.values()] for name in next(iter(images.values()))}
    return {k: float(np.mean([*map(float, v)])) for k, v in columns.items() if None not in v}


@dataclass(frozen=True, kw_only=True)
class Show:
    """What one renderer shows: its run, and the methods to draw with it by the names of rows."""

    run: str
    asset: pcore.Asset
    methods: Mapping[str, str]


def shows_of(name: str, runs: Path, joint: Sequence[str], methods: Sequence[str]) -> list[Show]:
    """All renderers of an object; those that learned with a skinning show only that one."""
    everything = {method: method for method in (*methods, TRUE)}
    found = [
        Show(run=run, asset=pcore.load(runs / run), methods=everything)
        for run in (name, f"{name}-pcore")
    ]
    for suffix in joint:
        own = {one: f"{one}, renderer of {suffix}" for one in (joint_name(suffix), TRUE)}
        run = f"{name}-{suffix}"
        found.append(Show(run=run, asset=pcore.load(runs / run), methods=own))
    return found


def joint_name(suffix: str) -> str:
    """What rows call the weights of a run that learned them jointly."""
    return f"NBS, joint ({suffix})"


def score_object(
    name: str,
    data: Path,
    runs: Path,
    joint: Sequence[str],
    views: int,
    steps: int,
    perceptual: Perceptual | None,
    aware: bool,
) -> list[Row]:
    """All rows of one object."""
    root = data / "deformed" / name
    states = open_states(root, factor=2)
    truth = states.truth
    assert isinstance(truth, DeformedTruth)
    samples = load_samples(root)
    rest = torch.from_numpy(samples.positions(truth, None)).float()
    rows: list[Row] = []
    points = pcore.load(runs / name).points
    distance = path_distance(points, farthest_points(points, ANCHORS))
    graph = anchor_graph(distance.anchors, distance.between)
    print(f"{name}: {len(points)} points, mean anchor spacing {graph.spacing:.3f}", flush=True)
    methods = weighers(distance, points, steps)
    for suffix in joint:
        learned = pcore.load(runs / f"{name}-{suffix}").skinning
        if learned is None:
            raise SystemExit(f"{name}-{suffix}: no learned weights")
        methods[joint_name(suffix)] = learned
    shows = shows_of(name, runs, joint, list(methods))
    # Fine-tuning leaves the points alone, so that one set of weights serves all runs.
    assert all(torch.equal(show.asset.points, points) for show in shows)
    held_out(points, distance.anchors, methods)
    weights = {method: (weigh(points), weigh(rest)) for method, weigh in methods.items()}
    hung = truth.anchor(points)
    for state in states.select(MOTIONS[name])[1:]:
        carried = truth.follow(hung, state.name)
        surface = samples.positions(truth, state.name)
        pose = pose_from_places(graph, carried[distance.indices])
        moved = {m: skin(points, w, pose).positions for m, (w, _) in weights.items()}
        shells = {m: skin(rest, w, pose).positions.numpy() for m, (_, w) in weights.items()}
        for method, places in {**moved, TRUE: carried}.items():
            cloud = compare_clouds(places.numpy(), surface).row()
            shell = compare_clouds(shells.get(method, surface), surface, emd_points=16).row()
            geometry = {
                **cloud,
                **{f"surface_{k}": v for k, v in shell.items() if k != "emd"},
                "error": float((places - carried).norm(dim=1).mean()),
            }
            # The same rule for all methods: what is around a point is told by its neighbours.
            frames = estimated_maps(points, places) if aware else None
            drawn = pcore.MovedPoints(positions=places, local_maps=frames)
            for show in shows:
                if method not in show.methods:
                    continue
                called = show.methods[method]
                pictures = picture_scores(show.asset, drawn, state, views, perceptual)
                scores = means(pictures) | geometry
                rows.append(
                    Row(
                        run=show.run,
                        state=state.name,
                        method=called,
                        scores=scores,
                        images=pictures,
                    )
                )
                print(f"  {show.run} {state.name} {called}: {scores['foreground_psnr']:.2f} dB")
    return rows


def table(chosen: list[Row]) -> str:
    """Markdown table of means over the states, one line per method."""
    columns = [c for c in COLUMNS if c in chosen[0].scores]
    lines = [
        "| weights | " + " | ".join(COLUMNS[c] for c in columns) + " |",
        "|---" * (len(columns) + 1) + "|",
    ]
    for method in dict.fromkeys(row.method for row in chosen):
        own = [row.scores for row in chosen if row.method == method]
        means = {c: float(np.mean([scores[c] for scores in own])) for c in columns}
        shown = [f"{v:.2f}" if "psnr" in c else f"{v:.4f}" for c, v in means.items()]
        lines.append(f"| {method} | " + " | ".join(shown) + " |")
    return "\n".join(lines)


def main() -> None:
    """Score, print both tables, write the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--joint", nargs="+", default=[], help="runs NAME of RUNS/knight-NAME, ...")
    parser.add_argument("--views", type=int, default=20, help="test views per state")
    parser.add_argument("--steps", type=int, default=SkinningFitConfig().steps)
    parser.add_argument("--lpips", type=Path, help="folder of LPIPS weights")
    parser.add_argument("--rays", choices=("plain", "aware"), default="plain")
    parser.add_argument("--json", type=Path, help="where to write every row")
    options = parser.parse_args()
    lpips = load_perceptual(("alex",), folder=options.lpips) if options.lpips else None
    rows: list[Row] = []
    for name in MOTIONS:
        rows += score_object(
            name,
            options.data,
            options.runs,
            options.joint,
            options.views,
            options.steps,
            lpips,
            options.rays == "aware",
        )
    for title, tuned in (("PAPR", False), ("P-CORE", True)):
        chosen = [row for row in rows if (row.run not in MOTIONS) is tuned]
        print(f"\n{title}, mean of the six motions\n\n{table(chosen)}")
    if options.json:
        options.json.write_text(json.dumps([vars(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()

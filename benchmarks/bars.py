"""Quality of Gaussians at rest and under edits, trained here with their defaults, beside the bars.

DATA holds `deformed/{spot,knight,robot}` and `nerf_synthetic/{lego,chair}`. Every scene is trained
at 100 x 100 with one thread and scored on its test views (protocol `standard`), in OUT/SCENE; the
same command goes on where it was stopped. Writes OUT/bars.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch

import pcore
from benchmarks.capture_figures import scores_of
from pcore.asset.training import RunOptions
from pcore.evaluation.methods import open_subject
from pcore.evaluation.runner import mean
from pcore.evaluation.states import CANONICAL
from pcore.evaluation.summary import StateMean
from pcore.files.run_record import begun
from pcore.kernels.memory import keep_freed_memory

SCENES: dict[str, tuple[str, int, float]] = {
    "spot": ("deformed/spot", 2, 33.7),
    "knight": ("deformed/knight", 2, 36.3),
    "robot": ("deformed/robot", 2, 33.0),
    "lego": ("nerf_synthetic/lego", 4, 27.3),
    "chair": ("nerf_synthetic/chair", 4, 30.0),
}
"""Folder in DATA, divisor of the photos, and bar at rest, dB of the object."""
SECONDS = 120
"""Of one processor: the bar of a training."""
ANALYTIC, SKELETAL = 32.0, {"knight": 28.4, "robot": 30.0}
"""Bars of means over states, dB: of the three objects together, and of each."""
MARGIN = 0.5
"""Every state is to be so much better, dB, than PAPR was (`PAPR`)."""
PAPR = {
    "spot": {"bend60": 30.44, "scale2x": 29.79, "stretch": 28.58, "twist60": 29.93},
    "knight": {"bend60": 30.46, "scale2x": 30.60, "stretch": 29.60, "twist60": 31.11}
    | {"cheer": 28.16, "run": 27.09, "sit": 25.36},
    "robot": {"bend60": 28.59, "scale2x": 29.08, "stretch": 28.49, "twist60": 29.53}
    | {"dance": 27.44, "run": 29.30, "wave": 28.62},
}
"""`aware + light` of 2026-11-28 (docs/research/quality.md), dB."""
HOLES, HOLES_OF = 0.5, {("knight", "sit"): 1.0}
"""Further holes than at rest, points of percent of the object's pixels."""
LIT = "Gaussians affine + light"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=[*SCENES], default=[*SCENES])


def run(wish: argparse.Namespace) -> int:
    """Train, score, write and print."""
    keep_freed_memory()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    rest, states = list[str](), list[str]()
    found: dict[str, list[StateMean]] = {}
    for name in wish.only:
        found[name] = scored(wish.data / SCENES[name][0], wish.out / name, SCENES[name][1])
        rest.append(rest_line(name, found[name], open_subject(wish.out / name)))
        edited = state_lines(name, found[name])
        states += edited
        print(rest[-1], *edited, sep="\n", flush=True)
    text = "\n".join(
        [
            "| scene | PSNR, object | bar | whole image | SSIM | Gaussians | processor s | bar |",
            "|---" * 8 + "|",
            *rest,
            "",
            "| object | state | affine | affine + light | bar | holes over rest, points | bar |",
            "|---" * 7 + "|",
            *states,
            "",
            *mean_lines(found),
            "",
        ]
    )
    (wish.out / "bars.md").write_text(text, encoding="utf-8")
    print(f"written to {wish.out / 'bars.md'}")
    return 0


def scored(scene: Path, folder: Path, factor: int) -> list[StateMean]:
    """Train Gaussians unless they are, and take means over the test views of all states."""
    pcore.train(
        pcore.load_scene(scene, factor=factor),
        folder=folder,
        options=RunOptions(resume=begun(folder), tensorboard=False),
    )
    return scores_of(folder, ["all"])


def score(means: Sequence[StateMean], state: str, metric: str, method: str = LIT) -> float:
    """One figure; NaN where there is none."""
    found = [m.scores.get(metric) for m in means if (m.method, m.state) == (method, state)]
    return float("nan") if not found or found[0] is None else float(found[0])


def rest_line(name: str, means: Sequence[StateMean], asset: pcore.Asset) -> str:
    """The object as it was photographed, and what its training took."""
    figures = [score(means, CANONICAL, key) for key in ("foreground_psnr", "psnr", "ssim")]
    seconds = asset.record.seconds
    spent = "-" if seconds is None else f"{seconds:.0f}"
    return (
        f"| {name} | {figures[0]:.2f} | {SCENES[name][2]} | {figures[1]:.2f} | {figures[2]:.3f} | "
        f"{len(asset):,} | {spent} | {SECONDS} |"
    )


def state_lines(name: str, means: Sequence[StateMean]) -> list[str]:
    """Every deformed state beside what it is to pass."""
    lines: list[str] = []
    for state, then in PAPR.get(name, {}).items():
        baked = score(means, state, "foreground_psnr", "Gaussians affine")
        lit = score(means, state, "foreground_psnr")
        holes = 100 * (score(means, state, "hole_rate") - score(means, CANONICAL, "hole_rate"))
        lines.append(
            f"| {name} | {state} | {baked:.2f} | {lit:.2f} | {then + MARGIN:.2f} | {holes:+.1f} | "
            f"{HOLES_OF.get((name, state), HOLES)} |"
        )
    return lines


def mean_lines(found: dict[str, list[StateMean]]) -> list[str]:
    """Means over states of `affine + light`."""
    lit = {
        kind: {
            name: mean(
                [
                    one.scores["foreground_psnr"]
                    for one in means
                    if one.kind == kind and one.method == LIT and one.state != CANONICAL
                ]
            )
            for name, means in found.items()
        }
        for kind in ("analytic", "skeletal")
    }
    known = [value for value in lit["analytic"].values() if value is not None]
    each = ", ".join(f"{n} {v:.2f}" for n, v in lit["analytic"].items() if v is not None)
    lines = [f"Mean of the analytic states: {mean(known) or 0:.2f} (bar {ANALYTIC}): {each}"]
    return lines + [
        f"Mean of the skeletal states: {name} {value:.2f} (bar {SKELETAL[name]})"
        for name, value in lit["skeletal"].items()
        if value is not None
    ]

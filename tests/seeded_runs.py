"""Three small runs, made by seed: a plain one, one with a light, one with learned weights.

What draws them in two ways must give the same pictures to the last bit, whatever machine draws.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from tests.cli.toys import toy_surfels, write_run, write_scene

from pcore.contrib.learned_skinning import SkinningConfig, untrained_skinning
from pcore.deform.anchor_distance import path_distance
from pcore.files.skinning_file import SKINNING_FILE, save_skinning
from pcore.geometry.farthest_points import farthest_points
from pcore.relight.lamps import Light, sphere
from pcore.relight.light_file import LIGHT_FILE, save_light
from pcore.relight.relighting import Relighting

TWIST: dict[str, Any] = {"type": "twist", "axis": "z", "angle_deg": 60}
TURN: dict[str, Any] = {"type": "rigid", "axis": "x", "angle_deg": 120}
SCENE = "ball"
RUNS = ("plain", "lit", "rigged")


def write_runs(folder: Path) -> dict[str, Path]:
    """Make the scene and all three runs of it in a folder; by name."""
    torch.manual_seed(11)
    write_scene(folder / SCENE)
    runs = {name: folder / name for name in RUNS}
    for name, path in runs.items():
        _, cloud = write_run(path, scene=f"../{SCENE}", points=80, surfels=name == "lit", factor=1)
        if name == "lit":
            _write_light(path, cloud.positions)
        if name == "rigged":
            _write_weights(path, cloud.positions)
    return runs


def write_edits(folder: Path, runs: dict[str, Path]) -> dict[str, Path]:
    """An edit file for each run, which needs what the run has; by the name of the run."""
    from pcore.files.model_file import load_model

    points = load_model(runs["rigged"]).cloud.positions
    top = points[points[:, 2].argmax()]
    handle = {"near": top.tolist(), "to": (top + torch.tensor([0.0, 0.2, 0.4])).tolist()}
    drag = {"type": "anchors", "count": 20, "handles": [handle]}
    files: dict[str, Path] = {}
    for name, edit in (("plain", TWIST), ("lit", TURN), ("rigged", drag)):
        files[name] = folder / f"{name}.json"
        files[name].write_text(json.dumps({"version": 2, "edits": [edit]}))
    return files


def write_moving_edit(path: Path) -> Path:
    """A twist that grows from time 0 to 1."""
    track = {"keyframes": [[0, 0], [1, 60]]}
    path.write_text(json.dumps({"version": 2, "edits": [{**TWIST, "angle_deg": track}]}))
    return path


def _write_light(run: Path, positions: torch.Tensor) -> None:
    directions = sphere(40)
    light = Light(
        directions=directions,
        radiance=0.1 + (4 * directions[:, 2] - 2).exp(),
        nearness=torch.zeros(40),
        center=torch.zeros(3),
    )
    bright = torch.full((len(positions),), 0.3)
    save_light(run / LIGHT_FILE, Relighting.of(light, positions, toy_surfels(positions), bright))


def _write_weights(run: Path, positions: torch.Tensor) -> None:
    distance = path_distance(positions, farthest_points(positions, 20))
    skinning = untrained_skinning(distance, SkinningConfig(width=8))
    torch.nn.init.normal_(skinning.network.layers[-1].get_parameter("weight"))
    save_skinning(run / SKINNING_FILE, skinning)

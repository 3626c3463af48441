"""An object of the evaluation set made again from its mesh, against the pictures Blender gave.

    python -m benchmarks.made_again DATA/knight [--renderer blender] [--states test run] [--views 4]

First the numbers: camera poses of both splits, and the maps of the analytic states (bent about the
axis of the set's own `bend60`), as `pcore benchmark make` makes them, and their largest difference
from the set's; meshes of the set are in single precision. `--states` without any ends there.

The set has meshes and no paint: each vertex gets the mean colour of 25 training pictures that show
it, divided by the light that our studio shines on it. Printed for each state, over the views:
difference of the silhouettes (alpha, of 255: mean over the picture, largest), and of the colours
where both are solid (of 255: mean of the absolute, signed), and the foreground PSNR. Nothing is
chosen on this.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from pcore.benchmark.blender_renderer import blender
from pcore.benchmark.look import (
    FloatArray,
    Look,
    Material,
    display,
    linear_rgba,
    smooth_patches,
)
from pcore.benchmark.making import SPLITS
from pcore.benchmark.model_states import formulas
from pcore.benchmark.renderers import Job, embedded
from pcore.benchmark.true_picture import Shape, light_on
from pcore.sample.sample_render import camera_poses

_PHOTOS = 25


def main() -> None:
    """Render, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--renderer", choices=("embedded", "blender"), default="embedded")
    parser.add_argument("--states", nargs="*", default=["test", "run"])
    parser.add_argument("--views", type=int, default=4)
    given = parser.parse_args()
    with np.load(given.data / "meshes.npz", allow_pickle=False) as file:
        meshes = {name: file[name] for name in file.files}
    faces = meshes["faces"].astype(np.int64)
    vertices = meshes["canonical"].astype(np.float64)
    print(f"{given.data.name} poses: {told_poses(given.data)}")
    print(f"{given.data.name} maps: {told_maps(given.data, meshes)}", flush=True)
    if not given.states:
        return
    look = Look(
        materials=(Material(color=(1.0, 1.0, 1.0, 1.0)),),
        material_of_face=np.zeros(len(faces), dtype=np.int64),
        smooth=smooth_patches(vertices, None),
    )
    rest = Shape.of(vertices, faces, look)
    colors, exposure = painted(given.data, rest, look)
    look = replace(look, colors=colors)
    for state in given.states:
        folder = given.data if state == "test" else given.data / state
        shape = rest
        if state != "test":
            shape = Shape.of(meshes[state].astype(np.float64), faces, look)
        jobs, truth = views(folder, shape, given.views)
        size = truth[0].shape[0]
        chosen = embedded(look, resolution=size, lit=None)
        if given.renderer == "blender":
            chosen = blender(look, resolution=size)
        made = [exposed(shot.rgba, exposure) for shot in chosen(jobs)]
        print(f"{given.data.name} {state} {given.renderer}: {told(made, truth)}", flush=True)


def told_poses(folder: Path) -> str:
    """Largest difference of the entries of the camera poses of both splits."""
    worst: dict[str, float] = {}
    for split, place in SPLITS.items():
        record = json.loads((folder / f"transforms_{split}.json").read_text())
        known = np.array([one["transform_matrix"] for one in record["frames"]])
        ours = camera_poses(len(known), **place)
        worst[split] = float(np.abs(known - ours).max())
    return ", ".join(f"{split} {value:.1e}" for split, value in worst.items())


def told_maps(folder: Path, meshes: dict[str, Any]) -> str:
    """Largest distance of the vertices of each analytic state, in radii of the object."""
    vertices = meshes["canonical"].astype(np.float64)
    record = json.loads((folder / "bend60" / "deformation.json").read_text())
    bend_axis = record["axis"].lower()
    worst: dict[str, float] = {}
    for name, one in formulas(vertices, bend_axis).items():
        moved = one.deformation(torch.from_numpy(vertices)).numpy()
        worst[name] = float(np.linalg.norm(moved - meshes[name], axis=1).max())
    told = ", ".join(f"{name} {value:.1e}" for name, value in worst.items())
    return f"{told} (--bend-axis {bend_axis})"


def views(folder: Path, shape: Shape, count: int, split: str = "test") -> tuple[list[Job], Any]:
    """Views spread over a split, and their pictures (H, W, 4) uint8."""
    record = json.loads((folder / f"transforms_{split}.json").read_text())
    frames = record["frames"][:: max(1, len(record["frames"]) // count)][:count]
    pose = [np.array(one["transform_matrix"], dtype=np.float64) for one in frames]
    paths = [folder / f"{one['file_path']}.png" for one in frames]
    jobs = [
        Job(path=path, shape=shape, pose=one, angle_x=record["camera_angle_x"])
        for path, one in zip(paths, pose, strict=True)
    ]
    return jobs, [np.asarray(Image.open(path).convert("RGBA")) for path in paths]


def exposed(rgba: Any, exposure: float) -> Any:
    """A picture (H, W, 4) uint8 of more light."""
    linear = linear_rgba(rgba)
    rgb = display(exposure * linear[..., :3])
    return np.rint(255 * np.dstack([rgb, linear[..., 3]])).astype(np.uint8)


def painted(folder: Path, shape: Shape, look: Look) -> tuple[FloatArray, float]:
    """Linear RGBA (V, 4) of vertices, from training pictures that show them, without our light.

    Returns:
        The paint, at most white, and how much brighter the pictures' light was.
    """
    vertices, faces = shape.caster.vertices, shape.caster.faces
    normal = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normal, faces[:, k], shape.normals)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-12)
    total, count = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    jobs, pictures = views(folder, shape, _PHOTOS, "train")
    for job, picture in zip(jobs, pictures, strict=True):
        away = job.pose[:3, 3] - vertices
        facing = np.einsum("vc,vc->v", normal, away) > 0.3 * np.linalg.norm(away, axis=1)
        seen = facing & ~shape.caster.blocked(vertices + 2e-3 * normal, job.pose[:3, 3])
        local = (vertices - job.pose[:3, 3]) @ job.pose[:3, :3]
        size = len(picture)
        focal = 0.5 * size / np.tan(0.5 * job.angle_x)
        column = np.floor(0.5 * size - focal * local[:, 0] / local[:, 2]).astype(int)
        row = np.floor(0.5 * size + focal * local[:, 1] / local[:, 2]).astype(int)
        rgba = linear_rgba(picture[row.clip(0, size - 1), column.clip(0, size - 1)])
        seen &= rgba[:, 3] == 1
        total[seen] += rgba[seen, :3]
        count += seen
    first = np.zeros(len(vertices), dtype=np.int64)
    corner = np.zeros(len(vertices), dtype=np.int64)
    for k in range(3):
        first[faces[:, k]], corner[faces[:, k]] = np.arange(len(faces)), k
    light = light_on(shape, look, first, np.eye(3)[corner], facing=np.ones(len(vertices)))
    colors = total / count.clip(1)[:, None] / light[:, None]
    colors[count == 0] = np.median(colors[count > 0], axis=0)
    exposure = max(1.0, float(np.percentile(colors, 99.5)))
    paint = (colors / exposure).clip(0, 1)
    return np.column_stack([paint, np.ones(len(vertices))]), exposure


def told(made: list[Any], truth: list[Any]) -> str:
    """The figures of one state."""
    alpha, color, signed, square = [], [], [], []
    for one, other in zip(made, truth, strict=True):
        first, second = one.astype(np.float64), other.astype(np.float64)
        difference = first - second
        alpha.append(np.abs(difference[..., 3]))
        solid = (one[..., 3] == 255) & (other[..., 3] == 255)
        color.append(np.abs(difference[solid][:, :3]).mean())
        signed.append(difference[solid][:, :3].mean())
        square.append(np.mean((difference[solid][:, :3] / 255) ** 2))
    return (
        f"silhouettes mean {np.mean(alpha):.2f}, largest {np.max(alpha):.0f}; colours mean "
        f"{np.mean(color):.1f}, signed {np.mean(signed):+.1f}, PSNR "
        f"{-10 * np.log10(np.mean(square)):.1f} dB"
    )


if __name__ == "__main__":
    main()

"""Five objects of our own with paint as fine as a few pixels, and true pictures of their states.

    python -m benchmarks.textured_scenes OUT [--resolution 50] [--views 60] [--only NAME]

Makes OUT/vase, OUT/ring, OUT/knot, OUT/pebble and OUT/figure in the layout of evaluation sets
(states `twist60`, `bend60`, `stretch`, `scale2x`), ray cast by the renderer of the embedded sample:
nothing but the extra `sample` is needed (and scikit-image for the figure). For choices that must
not be made on the test data's own states, and for laws about fine-tuning: such paint is what it
blurs first.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from benchmarks import lit_scenes
from pcore.sample.sample_render import MeshCaster, camera_poses, render_rgba
from pcore.sample.sample_states import ANGLE_X, deformed_states, describe_state

Array = NDArray[Any]
Painted = tuple[Array, Array, Array]
"""Vertices (V, 3), faces (F, 3), colours (V, 3) in [0, 1]."""

_RADIUS = 4.0
_TEST_VIEWS = 10


def main() -> None:
    """Write the scenes that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--resolution", type=int, default=50, help="pixels a side")
    parser.add_argument("--views", type=int, default=60, help="training views")
    parser.add_argument("--only", choices=OBJECTS)
    wish = parser.parse_args()
    for name in [wish.only] if wish.only else OBJECTS:
        write_scene(wish.out / name, OBJECTS[name](), wish.views, wish.resolution)


def write_scene(folder: Path, painted: Painted, count: int, resolution: int) -> None:
    """Write photos, states and meshes of an object, sized to a radius of 1 about the origin."""
    vertices, faces, colors = painted
    center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    vertices = (vertices - center) / np.linalg.norm(vertices - center, axis=1).max()
    train = camera_poses(count, radius=_RADIUS, highest=0.97, phase=0.0)
    test = camera_poses(_TEST_VIEWS, radius=_RADIUS, highest=0.93, phase=1.234)

    def views(place: Path, split: str, poses: Array, mesh: Array, angle_x: float) -> None:
        (place / split).mkdir(parents=True)
        caster = MeshCaster(mesh, faces)
        frames: list[dict[str, Any]] = []
        for i, pose in enumerate(poses):
            rgba = render_rgba(caster, colors, pose, angle_x=angle_x, resolution=resolution)
            Image.fromarray(rgba).save(place / split / f"r_{i}.png")
            frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": pose.tolist()})
        _write_json(
            place / f"transforms_{split}.json", {"camera_angle_x": angle_x, "frames": frames}
        )

    views(folder, "train", train, vertices, ANGLE_X)
    views(folder, "test", test, vertices, ANGLE_X)
    meshes = {"canonical": vertices.astype(np.float32)}
    for name, state in deformed_states(vertices).items():
        moved = state.deformation(torch.from_numpy(vertices)).numpy()
        views(folder / name, "test", test, moved, state.angle_x)
        _write_json(folder / name / "deformation.json", describe_state(state, vertices, moved))
        meshes[name] = moved.astype(np.float32)
    np.savez_compressed(folder / "meshes.npz", faces=faces.astype(np.int32), **meshes)


def _vase() -> Painted:
    """A turned body with a spiral of checks."""
    around, up = _grid(420, 420)
    height = 2 * up - 1
    radius = 0.32 + 0.16 * np.sin(2.6 * height + 0.4) + 0.04 * np.sin(14 * height)
    radius *= np.sqrt(np.clip(1 - height**8, 0, 1))
    vertices = np.stack([radius * np.cos(around), radius * np.sin(around), 0.9 * height], axis=-1)
    check = np.sin(11 * around + 9 * height) * np.sin(34 * height) > 0
    colors = _two(check, (0.92, 0.86, 0.7), (0.12, 0.25, 0.5))
    return _tube(vertices, colors)


def _ring() -> Painted:
    """A torus in fine rope."""
    around, along = _grid(260, 700)
    along = 2 * np.pi * along
    tube = 0.26 + 0.02 * np.cos(3 * around + 12 * along)
    reach = 0.7 + tube * np.cos(around)
    vertices = np.stack(
        [reach * np.cos(along), 0.8 * reach * np.sin(along), tube * np.sin(around)], axis=-1
    )
    strand = np.sin(5 * around + 31 * along) > 0.1
    colors = _two(strand, (0.85, 0.55, 0.2), (0.3, 0.08, 0.12))
    colors *= 0.8 + 0.2 * np.cos(9 * around - 4 * along)[..., None]
    return _tube(vertices, colors)


def _knot() -> Painted:
    """A trefoil with narrow bands."""
    around, along = _grid(160, 1200)
    turn = 2 * np.pi * along[0]
    path = np.stack(
        [
            np.sin(turn) + 2 * np.sin(2 * turn),
            np.cos(turn) - 2 * np.cos(2 * turn),
            -1.2 * np.sin(3 * turn),
        ],
        axis=-1,
    )
    tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    over = np.cross(side, tangent)
    offset = np.cos(around)[..., None] * side + np.sin(around)[..., None] * over
    band = np.sin(48 * 2 * np.pi * along + 2 * np.sin(2 * around)) > 0
    colors = _two(band, (0.9, 0.3, 0.2), (0.15, 0.5, 0.45))
    colors[np.sin(4 * around + 20 * 2 * np.pi * along) > 0.8] = 0.95, 0.9, 0.6
    return _tube(path + 0.62 * offset, colors)


def _pebble() -> Painted:
    """A bumpy stone with speckles of three sizes."""
    around, up = _grid(480, 480)
    polar = np.pi * up
    ball = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
    )
    x, y, z = np.moveaxis(ball, -1, 0)
    bumps = 0.12 * np.sin(5 * x + 2 * z) + 0.1 * np.sin(6 * y - 3 * x) + 0.06 * np.sin(9 * z)
    vertices = ball * (0.8 + bumps)[..., None] * (1.0, 0.75, 0.7)
    grain = _speckles(vertices, seed=2, sizes=(8.0, 20.0, 40.0))
    colors = np.array([0.5, 0.48, 0.42]) * np.exp(0.3 * grain)[..., None]
    colors[_speckles(vertices, seed=3, sizes=(16.0,)) > 1.0] = 0.7, 0.25, 0.15
    return _tube(vertices, np.clip(colors, 0.02, 0.98))


def _figure() -> Painted:
    """The figure of `lit_scenes` in speckled clothes with a light baked in."""
    vertices, faces = lit_scenes.figure_mesh()
    grain = _speckles(vertices, seed=1, sizes=(9.0, 20.0, 45.0))
    colors = lit_scenes.clothes(vertices) * np.exp(0.25 * grain)[:, None]
    return vertices, faces, np.clip(colors, 0.02, 0.98) ** (1 / 2.2)


OBJECTS: dict[str, Callable[[], Painted]] = {
    "vase": _vase,
    "ring": _ring,
    "knot": _knot,
    "pebble": _pebble,
    "figure": _figure,
}


def _grid(around: int, along: int) -> tuple[Array, Array]:
    """Angle about and share along a tube, (around, along) each."""
    return np.meshgrid(
        np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(0, 1, along), indexing="ij"
    )


def _tube(vertices: Array, colors: Array) -> Painted:
    """Close a grid (around, along) of vertices about its axis; ends meet or are points."""
    around, along = vertices.shape[:2]
    index = np.arange(around * along).reshape(around, along)
    a, b = index[:, :-1], np.roll(index, -1, axis=0)[:, :-1]
    c, d = np.roll(index, -1, axis=0)[:, 1:], index[:, 1:]
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return vertices.reshape(-1, 3), faces, np.clip(colors, 0, 1).reshape(-1, 3)


def _two(mask: Array, first: tuple[float, ...], second: tuple[float, ...]) -> Array:
    return np.where(mask[..., None], first, second)


def _speckles(points: Array, *, seed: int, sizes: tuple[float, ...]) -> Array:
    """Smooth noise (...) of points (..., 3): waves of these frequencies, unit variance."""
    random = np.random.default_rng(seed)
    total = np.zeros(points.shape[:-1])
    for size in sizes:
        waves = random.normal(size=(24, 3)) * size
        phases = random.uniform(0, 2 * np.pi, 24)
        total += np.cos(points @ waves.T + phases).mean(axis=-1) * np.sqrt(2 * 24 / len(sizes))
    return total


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()

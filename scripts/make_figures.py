"""Figures of the documentation, from the embedded sample alone.

    python scripts/make_figures.py edits [--out docs/images]
    python scripts/make_figures.py movie RUN [--out docs/images]

`edits` draws every type of edit and every region as points; it needs no training. `movie` films an
edit of RUN, a run that learned the sample (`make_sample("sample")`, `pcore train sample -o RUN`):
the object under plain rays, as PAPR draws it, beside the default way.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
import tyro
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor
from tyro.conf import Positional

import pcore
from pcore.data.pictures import to_bytes
from pcore.data.splat import point_picture
from pcore.evaluation.figures import Pixels, sheet
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_cameras
from pcore.sample.sample_mesh import snail

IMAGES = Path("docs/images")
POINTS, CELL, FINER = 30_000, 150, 3
"""Points drawn, side of a picture, and how much finer it is drawn before it is averaged."""
SHELL = {"shape": "sphere", "center": [0.0, 0.2, 0.45], "radius": 0.35, "falloff": 0.25}
FORMULAS: dict[str, dict[str, Any]] = {
    "twist": {"type": "twist", "axis": "z", "angle_deg": 90},
    "bend": {"type": "bend", "axis": "y", "angle_deg": 60},
    "taper": {"type": "taper", "axis": "z", "factor": -0.8},
    "stretch, blender": {"type": "stretch", "axis": "z", "factor": 0.6},
    "stretch, axial": {"type": "stretch", "axis": "z", "factor": 0.6, "profile": "axial"},
    "stretch, volume": {"type": "stretch", "axis": "z", "factor": 0.6, "profile": "volume"},
    "scale": {"type": "scale", "factor": 0.6},
    "rigid": {"type": "rigid", "axis": "y", "angle_deg": 40, "translation": [0.2, 0, 0]},
}
REGIONS: dict[str, dict[str, Any]] = {
    "box": {"shape": "box", "lower": [-1, -1, -0.1], "upper": [1, 1, 1], "falloff": 0.1},
    "sphere": SHELL,
    "half_space": {"shape": "half_space", "normal": [1, 0, 0], "falloff": 0.3},
    "points": {"shape": "points", "ids": list(range(40)), "falloff": 0.15},
    "geodesic": {"shape": "geodesic", "center": [0, 0, 0.5], "radius": 0.5, "falloff": 0.3},
    "mask": {"shape": "mask", "file": "mask.npy"},
}


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """Points of the sample's surface.

    Attributes:
        points: (N, 3) float32, world units.
        colors: (N, 3) uint8.
        camera: who looks.
    """

    points: Tensor
    colors: Tensor
    camera: Camera

    def picture(self, points: Tensor, colors: Tensor | None = None) -> Pixels:
        """Draw the points where they are moved to, (CELL, CELL, 3)."""
        paint = self.colors if colors is None else colors
        fine = point_picture(points.float(), paint, self.camera, dot=7)
        return np.asarray(Image.fromarray(fine.numpy()).reduce(FINER))

    def edited(self, *edits: dict[str, Any], freeze: tuple[Any, ...] = ()) -> Pixels:
        """Draw the object under edits."""
        script = pcore.parse_edit({"version": 2, "edits": list(edits), "freeze": list(freeze)})
        return self.picture(script.bind(self.points)(self.points))


def sample_points() -> Drawn:
    """Points evenly over the painted snail, and a camera that sees it and what edits make of it."""
    mesh = snail()
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    places, faces = trimesh.sample.sample_surface(shape, POINTS, seed=0)
    colors = torch.from_numpy(mesh.colors[mesh.faces[faces, 0]]).float()
    camera = orbit_cameras(
        torch.zeros(3),
        5.0,
        8,
        elevation=math.radians(20),
        width=CELL * FINER,
        height=CELL * FINER,
        angle_x=math.radians(28),
    )[6]
    return Drawn(
        points=torch.from_numpy(np.asarray(places)).float(),
        colors=to_bytes(colors),
        camera=camera,
    )


def shape_edits(drawn: Drawn, folder: Path) -> dict[str, dict[str, Any]]:
    """Edits by files, which are written into the folder."""
    bend = pcore.parse_edit({"version": 2, "edits": [FORMULAS["bend"]]}).bind(drawn.points)
    box = trimesh.creation.box(extents=2.0 * drawn.points.abs().amax(dim=0).numpy() + 0.2)
    cage = box.subdivide().subdivide()
    _write_pair(folder, "cage", cage, bend)
    coarse = snail(step=0.05)
    _write_pair(folder, "mesh", trimesh.Trimesh(coarse.vertices, coarse.faces, process=False), bend)
    thrown = drawn.points.clone()
    thrown[:, 2] += 0.12 * torch.sin(7.0 * thrown[:, 0])
    np.save(folder / "old.npy", drawn.points.numpy())
    np.save(folder / "new.npy", thrown.numpy())
    top = drawn.points[drawn.points[:, 2].argmax()].tolist()
    pair = {"before": str(folder / "cage.ply"), "after": str(folder / "cage_after.ply")}
    return {
        "part": {"type": "part", "region": SHELL, "factor": 1.4, "translation": [0, 0, 0.15]},
        "cage": {"type": "cage", **pair},
        "cage, amount 0.5": {"type": "cage", **pair, "amount": 0.5},
        "mesh": {
            "type": "mesh",
            "before": str(folder / "mesh.ply"),
            "after": str(folder / "mesh_after.ply"),
        },
        "displacement": {
            "type": "displacement",
            "before": str(folder / "old.npy"),
            "after": str(folder / "new.npy"),
        },
        "anchors": {
            "type": "anchors",
            "handles": [{"near": top, "to": [top[0] + 0.4, top[1], top[2] + 0.2]}],
            "reach": 1.0,
        },
    }


def _write_pair(folder: Path, name: str, mesh: Any, deformation: pcore.Deformation) -> None:
    mesh.export(folder / f"{name}.ply")
    moved = deformation(torch.from_numpy(np.asarray(mesh.vertices))).numpy()
    trimesh.Trimesh(moved, mesh.faces, process=False).export(folder / f"{name}_after.ply")


def weights(drawn: Drawn, entry: dict[str, Any], folder: Path) -> Tensor:
    """Weight (N,) of a region, by how far it lets a small shift of everything go."""
    if entry["shape"] == "mask":
        np.save(folder / "mask.npy", (drawn.points[:, 2].abs() < 0.15).numpy())
        entry = {**entry, "file": str(folder / "mask.npy")}
    shift = {"type": "rigid", "translation": [0.001, 0, 0], "region": entry}
    moved = pcore.parse_edit({"version": 2, "edits": [shift]}).bind(drawn.points)(drawn.points)
    return ((moved - drawn.points)[:, 0] / 0.001).clamp(0.0, 1.0)


def grid(pictures: dict[str, Pixels], columns: int) -> Pixels:
    """Lay named pictures out, each with its name above it."""
    names, shown = list(pictures), list(pictures.values())
    rows = []
    for first in range(0, len(names), columns):
        part: list[Pixels | None] = [*shown[first : first + columns]]
        part += [None] * (columns - len(part))
        titles = names[first : first + columns] + [""] * (columns - len(part))
        titles += [""] * (columns - len(titles))
        rows.append(sheet(titles, [("", part)], cell=CELL))
    return np.concatenate(rows)


def save(page: Pixels, path: Path, colors: int = 96) -> None:
    """Write a small PNG."""
    Image.fromarray(page).quantize(colors).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def edits(*, out: Path = IMAGES) -> None:
    """Draw every type of edit and every region.

    Args:
        out: folder for the figures.
    """
    drawn = sample_points()
    rest = {"as photographed": drawn.picture(drawn.points)}
    formulas = {name: drawn.edited(entry) for name, entry in FORMULAS.items()}
    save(grid(rest | formulas, 3), out / "edit-types.png")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shapes = shape_edits(drawn, folder)
        save(
            grid({key: drawn.edited(entry) for key, entry in shapes.items()}, 3),
            out / "edit-shapes.png",
        )
        pictures = {}
        for key, entry in REGIONS.items():
            share = weights(drawn, entry, folder)[:, None]
            paint = (1.0 - share) * drawn.colors * 0.5 + share * torch.tensor([255.0, 120.0, 0.0])
            grey = (1.0 - share) * 110.0
            pictures[key] = drawn.picture(drawn.points, (0.999 * (paint + grey)).to(torch.uint8))
    frozen = {"shape": "half_space", "normal": [0, 0, -1], "origin": [0, 0, -0.2], "falloff": 0.5}
    twist = FORMULAS["twist"]
    pictures["twist"] = drawn.edited(twist)
    pictures["twist in a region"] = drawn.edited({**twist, "region": REGIONS["sphere"]})
    pictures["twist, foot frozen"] = drawn.edited(twist, freeze=(frozen,))
    save(grid(pictures, 3), out / "regions.png")


def movie(run: Positional[Path], *, out: Path = IMAGES, frames: int = 40, size: int = 220) -> None:
    """Film an edit of a run of the sample, with plain rays beside the default.

    Args:
        run: folder of the run.
        out: folder for the film.
        frames: pictures of the film.
        size: side of each half in pixels.
    """
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    asset = pcore.load(run)
    shown: list[Image.Image] = []
    for number in range(frames):
        turn = 2.0 * math.pi * number / frames
        script = pcore.parse_edit({"version": 2, "edits": _movement(turn)})
        camera = orbit_cameras(
            torch.zeros(3),
            4.6,
            frames,
            elevation=math.radians(20),
            width=size,
            height=size,
            angle_x=math.radians(28),
        )[(number + 7 * frames // 8) % frames]
        halves = [
            asset.render(asset.pose(script, rays=rays, light="baked"), camera).rgb
            for rays in ("plain", "aware")
        ]
        shown.append(Image.fromarray(to_bytes(torch.cat(halves, dim=1).clamp(0, 1)).numpy()))
        print(f"frame {number + 1} of {frames}", end="\r")
    path = out / "edit.gif"
    write_gif(path, shown)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


def _movement(turn: float) -> list[dict[str, Any]]:
    """A twist and a stretch that come and go once, for an angle from 0 to 2 pi."""
    lift = 0.5 * (1.0 - math.cos(turn))
    return [
        {"type": "twist", "axis": "z", "angle_deg": 100.0 * math.sin(turn)},
        {"type": "stretch", "axis": "z", "factor": 0.5 * lift, "profile": "axial"},
    ]


def write_gif(path: Path, frames: list[Image.Image]) -> None:
    """Write a film that repeats, all of it with one palette."""
    strip: NDArray[np.uint8] = np.concatenate([np.asarray(frame) for frame in frames])
    palette = Image.fromarray(strip).quantize(96)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(path, save_all=True, append_images=few[1:], duration=80, loop=0, optimize=True)


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"edits": edits, "movie": movie})

"""The paper's figure of sequential edits on a real object, on a capture of one's own.

    python -m benchmarks.sequential_edits RUN -o FOLDER [--edits FIRST.json SECOND.json ...]

Draws RUN at rest and after each edit, every one on top of those before, from test views of its
scene: pictures, depth maps (edits.png) and holes (edits.csv). Without --edits: a twist about the
pictures' upright, a bend across it, and the upper part turned and enlarged with a soft seam.

Holes are counted over the object's own canonical depth, as a capture has no other: the surface that
a test view shows at rest, from pixel to pixel, moves along with the edits. Where the view's moved
surface covers a pixel, the picture has to be opaque, and no more than 5 % of the object's size
behind it: `hole_rate`. What has moved in front of it is no hole; `off_rate` counts depth that is
off either way, as docs/concepts/metrics.md does where the truth is known.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import pcore
from pcore.asset.meshing import map_of, moved_mesh
from pcore.data.scene import Scene
from pcore.evaluation.figures import color_pixels, depth_pixels, depth_range, png_bytes, sheet
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import size_of
from pcore.geometry.surface_mesh import SurfaceMesh
from pcore.metrics.geometry_metrics import SOLID_ALPHA, TrueGeometry, measure_geometry
from pcore.render.image import Image

NAMES = ("+ twist", "+ bend", "+ part")
_FINER = 3
"""Rays per pixel and side that tell how much of it the surface covers."""
_JUMP = 6.0
"""Pixel widths by which four neighbouring pixels may differ in depth and still be one surface."""


@dataclass(frozen=True, kw_only=True)
class Holes:
    """Rates of one picture, as fractions of the pixels that the moved surface covers."""

    hole_rate: float
    see_through_rate: float
    off_rate: float
    solid_pixels: int


@dataclass(frozen=True, kw_only=True)
class Drawn:
    """One state of the sequence.

    Attributes:
        title: column of the figure.
        pictures: one per view.
        scores: holes of each view.
    """

    title: str
    pictures: tuple[Image, ...]
    scores: tuple[Holes, ...]


def own_edits(points: Tensor, cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    """Three edits that fit any object: points (N, 3) say where it is, cameras what is upright."""
    middle = points.double().median(dim=0).values
    radius = float((points.double() - middle).norm(dim=-1).quantile(0.9))
    up = _mean_axis(cameras, 1)
    across = torch.linalg.cross(up, _mean_axis(cameras, 2))
    origin = middle.tolist()
    span = {"origin": origin, "extent": [-radius, radius]}
    top = (middle + 0.6 * radius * up).tolist()
    region = {"shape": "sphere", "center": top, "radius": 0.45 * radius, "falloff": 0.6 * radius}
    return [
        {"type": "twist", "axis": up.tolist(), "angle_deg": 35, **span},
        {"type": "bend", "axis": across.tolist(), "angle_deg": 35, **span},
        {
            "type": "part",
            "axis": up.tolist(),
            "angle_deg": 20,
            "factor": 1.2,
            "origin": top,
            "region": region,
        },
    ]


def edits_for(asset: pcore.Asset, scene: Scene) -> list[dict[str, Any]]:
    """`own_edits` of an object, upright as the cameras of its photos are."""
    return own_edits(asset.points, [view.camera for view in scene.split("train")])


def sequence(
    asset: pcore.Asset, scene: Scene, edits: Sequence[dict[str, Any]], titles: Sequence[str]
) -> list[Drawn]:
    """Draw the object at rest and after each edit on top of those before, from all test views."""
    cameras = [view.camera for view in scene.split("test")]
    rest = taken(asset, None, cameras)
    surfaces = [surface_of(one, camera) for one, camera in zip(rest, cameras, strict=True)]
    return [
        draw(asset, surfaces, edits[:count], cameras, title)
        for count, title in enumerate(["at rest", *titles])
    ]


def _mean_axis(cameras: Sequence[Camera], axis: int) -> Tensor:
    axes = torch.stack([camera.world_from_camera[:3, axis] for camera in cameras])
    return torch.nn.functional.normalize(axes.double().mean(dim=0), dim=0)


def draw(
    asset: pcore.Asset,
    surfaces: Sequence[SurfaceMesh],
    edits: Sequence[dict[str, Any]],
    cameras: Sequence[Camera],
    title: str,
) -> Drawn:
    """Draw the object under a sequence of edits and count holes over its moved surfaces."""
    edit = {"version": 2, "edits": [*edits]} if edits else None
    pictures = taken(asset, edit, cameras)
    field = map_of(asset, edit)
    scores = [
        holes(one, moved_mesh(mesh, field), camera, size_of(asset.points))
        for one, mesh, camera in zip(pictures, surfaces, cameras, strict=True)
    ]
    return Drawn(title=title, pictures=pictures, scores=tuple(scores))


def taken(
    asset: pcore.Asset, edit: dict[str, Any] | None, cameras: Sequence[Camera]
) -> tuple[Image, ...]:
    """Pictures of the object under an edit; runs with a light show it."""
    posed = asset.pose(edit, rays="aware")
    return tuple(asset.render(posed, camera).cpu() for camera in cameras)


def surface_of(picture: Image, camera: Camera) -> SurfaceMesh:
    """The surface that a picture shows: a vertex for each pixel, no faces over jumps in depth."""
    height, width = picture.depth.shape
    solid = (picture.alpha > SOLID_ALPHA) & picture.depth.isfinite()
    number = torch.arange(height * width).reshape(height, width)
    corners = [(slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None))]
    corners += [(slice(1, None), slice(1, None)), (slice(1, None), slice(None, -1))]
    depths = torch.stack([picture.depth.nan_to_num(0.0)[one] for one in corners])
    pixel = depths.mean(dim=0) / camera.fx
    smooth = (depths.amax(dim=0) - depths.amin(dim=0)) < _JUMP * pixel
    kept = torch.stack([solid[one] for one in corners]).all(dim=0) & smooth
    a, b, c, d = (number[one][kept] for one in corners)
    faces = torch.cat([torch.stack([a, b, c], dim=1), torch.stack([a, c, d], dim=1)])
    places = torch.where(solid[..., None], picture.surface, torch.zeros(3)).reshape(-1, 3)
    return SurfaceMesh(vertices=places.double(), faces=faces, colors=torch.zeros_like(places))


def holes(picture: Image, mesh: SurfaceMesh, camera: Camera, size: float) -> Holes:
    """Holes of a picture over a mesh; `size` is that of the object, world units."""
    vertices, faces = mesh.vertices.numpy(), mesh.faces.numpy()
    finer = replace(
        camera,
        width=_FINER * camera.width,
        height=_FINER * camera.height,
        fx=_FINER * camera.fx,
        fy=_FINER * camera.fy,
        cx=_FINER * camera.cx,
        cy=_FINER * camera.cy,
    )
    blocks = mesh_depth(vertices, faces, finer).isfinite().float()
    alpha = torch.nn.functional.avg_pool2d(blocks[None, None], _FINER)[0, 0]
    depth = mesh_depth(vertices, faces, camera)
    truth = TrueGeometry(alpha=alpha, depth=depth, object_size=size)
    drawn = torch.nan_to_num(picture.depth, nan=0.0, posinf=0.0)
    behind = torch.where(depth.isfinite(), torch.maximum(drawn, depth), drawn)
    either = measure_geometry(picture.alpha, drawn, truth)
    one = measure_geometry(picture.alpha, behind, truth)
    return Holes(
        hole_rate=one.hole_rate or 0.0,
        see_through_rate=one.see_through_rate or 0.0,
        off_rate=either.depth_off_rate or 0.0,
        solid_pixels=one.solid_pixels,
    )


def figure(states: Sequence[Drawn], views: Sequence[int]) -> bytes:
    """Rows: picture and depth map from each of the views; columns: rest and every edit."""
    rows: list[tuple[str, Sequence[Any]]] = []
    for view in views:
        shown = [state.pictures[view] for state in states]
        part = _box(torch.stack([one.alpha for one in shown]))
        span = depth_range([(one.alpha, one.depth) for one in shown])
        rows.append(("picture", [color_pixels(one.rgb[part]) for one in shown]))
        rows.append(
            ("depth", [depth_pixels(one.alpha[part], one.depth[part], span) for one in shown])
        )
    return png_bytes(sheet([state.title for state in states], rows, cell=240))


def _box(alpha: Tensor) -> tuple[slice, slice]:
    """Rows and columns of pictures (N, H, W) in which anything is to be seen, and a margin."""
    seen = (alpha >= SOLID_ALPHA).any(dim=0)
    ends: list[slice] = []
    for axis in (1, 0):
        places = seen.any(dim=axis).nonzero()
        first, last = (int(places.min()), int(places.max())) if len(places) else (0, len(seen))
        margin = (last - first) // 20 + 1
        ends.append(slice(max(first - margin, 0), last + margin + 1))
    return ends[0], ends[1]


def rate(state: Drawn, name: str) -> float:
    """A rate of a state in per cent, over all views: each counts by its pixels."""
    pixels = sum(one.solid_pixels for one in state.scores)
    return 100 * sum(getattr(one, name) * one.solid_pixels for one in state.scores) / max(pixels, 1)


def main() -> None:
    """Draw, count, write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--edits", type=Path, nargs="+", help="edit files, in this order")
    parser.add_argument("--scene", type=Path, help="default: that of the training")
    parser.add_argument("--show", type=int, nargs="+", default=[0], help="views of the figure")
    wish = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    asset = pcore.load(wish.run).over((1.0, 1.0, 1.0))
    scene = asset.scene() if wish.scene is None else pcore.load_scene(wish.scene)
    given = [one for file in wish.edits or () for one in json.loads(file.read_text())["edits"]]
    wish.output.mkdir(parents=True, exist_ok=True)
    edits = given or edits_for(asset, scene)
    states = sequence(asset, scene, edits, [f"+ {one['type']}" for one in given] or NAMES)
    for one in states:
        print(
            f"{one.title}: holes {rate(one, 'hole_rate'):.2f} %, of which see-through "
            f"{rate(one, 'see_through_rate'):.2f} %; off in depth either way "
            f"{rate(one, 'off_rate'):.2f} %; {len(one.pictures)} views",
            flush=True,
        )
    (wish.output / "edits.json").write_text(json.dumps({"version": 2, "edits": edits}, indent=1))
    (wish.output / "edits.png").write_bytes(figure(states, wish.show))
    with (wish.output / "edits.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ["state", "view", *asdict(states[0].scores[0])])
        writer.writeheader()
        for state in states:
            for number, scores in enumerate(state.scores):
                writer.writerow({"state": state.title, "view": number, **asdict(scores)})
    print(f"written to {wish.output}")


if __name__ == "__main__":
    main()

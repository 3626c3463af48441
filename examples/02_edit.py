"""Bind an edit to the points of a run and take pictures of the deformed object.

    python examples/02_edit.py RUN edit.json PICTURES

docs/guide/edit-files.md describes the edit file. PICTURES gets canonical.png, deformed.png and the
depth maps of both.
"""

from pathlib import Path

import torch
import tyro

import pcore
from pcore.data.pictures import depth_picture, depth_range, write_png
from pcore.editing.apply import deformed_cloud
from pcore.geometry.orbit import fitting_distance, orbit_cameras

ANGLE_X = 0.7


def main(run: Path, edit: Path, pictures: Path, /, size: int = 400) -> None:
    """Render a run before and after an edit.

    Args:
        run: folder of a run, or a model.safetensors.
        edit: an edit file.
        pictures: folder for the pictures.
        size: width and height in pixels.
    """
    model = pcore.load_model(run)
    papr, cloud = model.papr(), model.cloud

    # Binding freezes the edit to the canonical points; the result is a map of all of space.
    deformation = pcore.load_edit(edit).bind(cloud.positions)
    moved = deformed_cloud(cloud, deformation)

    lower, upper = cloud.extent()
    center = 0.5 * (lower + upper)
    distance = max(fitting_distance(one.positions, center, ANGLE_X) for one in (cloud, moved))
    camera = orbit_cameras(
        center, distance, 1, elevation=0.4, width=size, height=size, angle_x=ANGLE_X
    )[0]

    pictures.mkdir(parents=True, exist_ok=True)
    near, far = depth_range(torch.cat([cloud.positions, moved.positions]), [camera])
    for name, points in (("canonical", cloud), ("deformed", moved)):
        picture = pcore.render(papr, points, camera)
        write_png(pictures / f"{name}.png", picture.rgb)
        depth = depth_picture(picture.depth, picture.alpha, near=near, far=far)
        write_png(pictures / f"{name}_depth.png", depth)
        covered = float((picture.alpha > 0.5).float().mean())
        print(f"{name}: the object covers {100 * covered:.1f} % of the picture")


if __name__ == "__main__":
    tyro.cli(main)

"""Bend a run by an edit file and take pictures of it, as `pcore render` does.

    python examples/02_edit.py RUN edit.json PICTURES

docs/guide/edit-files.md describes the edit file. PICTURES gets canonical.png, deformed.png and the
depth maps of both.
"""

from pathlib import Path

import torch
import tyro

import pcore
from pcore.data.pictures import depth_picture, depth_range, write_png


def main(run: Path, edit: Path, pictures: Path, /, size: int = 400) -> None:
    """Render a run before and after an edit.

    Args:
        run: folder of a run, or a model.safetensors.
        edit: an edit file.
        pictures: folder for the pictures.
        size: width and height in pixels.
    """
    asset = pcore.load(run)
    rest, bent = asset.pose(), asset.pose(edit)

    both = torch.cat([rest.points, bent.points])
    camera = pcore.orbit_around(both, size=(size, size))[0]

    pictures.mkdir(parents=True, exist_ok=True)
    near, far = depth_range(both, [camera])
    for name, posed in (("canonical", rest), ("deformed", bent)):
        picture = asset.render(posed, camera)
        write_png(pictures / f"{name}.png", picture.rgb)
        depth = depth_picture(picture.depth, picture.alpha, near=near, far=far)
        write_png(pictures / f"{name}_depth.png", depth)
        covered = float((picture.alpha > 0.5).float().mean())
        print(f"{name}: the object covers {100 * covered:.1f} % of the picture")


if __name__ == "__main__":
    tyro.cli(main)

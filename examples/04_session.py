"""Edit a run step by step with undo, look at the strain, draw it, and save what was done.

    python examples/04_session.py RUN edit.json strain.png

The lowest quarter of the object is frozen, the rest is twisted until it would fold. The saved file
works with every command: `pcore render RUN --edit edit.json`.
"""

from pathlib import Path

import torch
import tyro

import pcore
from pcore.data.pictures import write_png
from pcore.data.splat import point_picture


def main(run: Path, edit: Path, picture: Path, /, step: float = 30.0, size: int = 400) -> None:
    """Twist a run in steps while its strain is low.

    Args:
        run: folder of a run, or a model.safetensors.
        edit: edit file to write.
        picture: PNG file to write: the object, and its points in the colours of their strain.
        step: degrees per step.
        size: width and height of the picture in pixels.
    """
    asset = pcore.load(run)
    lower, upper = asset.points.aminmax(dim=0)
    height = float(upper[2] - lower[2])
    session = asset.session()
    session.freeze(
        {
            "shape": "half_space",
            "normal": [0, 0, -1],
            "origin": [0, 0, float(lower[2]) + 0.25 * height],
            "falloff": 0.5 * height,
        }
    )
    twist = {"type": "twist", "axis": "z", "angle_deg": step}
    for _ in range(12):
        state = session.do(twist)
        found = pcore.diagnose(asset.points, state.points)
        print(f"{len(state.script.edits)} x {step:g} degrees: strain {found.numbers()}")
        if found.numbers()["strain_99"] > 2.0:
            session.undo()
            break
    state = session.state
    still = int((state.points == asset.points).all(dim=-1).sum())
    print(f"kept {len(state.script.edits)} steps, {still} points did not move at all")
    session.save(edit)

    camera = pcore.orbit_around(state.points, size=(size, size))[0]
    drawn = asset.render(asset.pose(session), camera).rgb
    colors = pcore.diagnose(asset.points, state.points).colors()
    strain = point_picture(state.points, colors, camera) / 255
    write_png(picture, torch.cat([drawn, strain], dim=1))


if __name__ == "__main__":
    tyro.cli(main)

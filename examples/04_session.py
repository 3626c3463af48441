"""Edit a run step by step with undo, look at the strain, and save what was done.

    python examples/04_session.py RUN edit.json strain.png

The lowest quarter of the object is frozen, the rest is twisted until it would fold. The saved file
works with every command: `pcore render RUN --edit edit.json`.
"""

from pathlib import Path

import tyro

import pcore
from pcore.data.pictures import write_png
from pcore.data.splat import point_picture
from pcore.editing.diagnosis import diagnose
from pcore.geometry.orbit import fitting_distance, orbit_cameras

ANGLE_X = 0.7


def main(run: Path, edit: Path, picture: Path, /, step: float = 30.0, size: int = 400) -> None:
    """Twist a run in steps while its strain is low.

    Args:
        run: folder of a run, or a model.safetensors.
        edit: edit file to write.
        picture: PNG file to write.
        step: degrees per step.
        size: width and height of the picture in pixels.
    """
    cloud = pcore.load_model(run).cloud
    lower, upper = cloud.extent()
    height = float(upper[2] - lower[2])
    session = pcore.EditSession(cloud.positions)
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
        found = diagnose(cloud.positions, state.points)
        print(f"{len(state.script.edits)} x {step:g} degrees: strain {found.numbers()}")
        if found.numbers()["strain_99"] > 2.0:
            session.undo()
            break
    state = session.state
    still = int((state.points == cloud.positions).all(dim=-1).sum())
    print(f"kept {len(state.script.edits)} steps, {still} points did not move at all")
    session.save(edit)

    center = state.points.mean(dim=0)
    distance = fitting_distance(state.points, center, ANGLE_X)
    camera = orbit_cameras(
        center, distance, 1, elevation=0.4, width=size, height=size, angle_x=ANGLE_X
    )[0]
    colors = diagnose(cloud.positions, state.points).colors()
    write_png(picture, point_picture(state.points, colors, camera))


if __name__ == "__main__":
    tyro.cli(main)

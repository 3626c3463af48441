"""The picture of `pcore edit apply`: points in the colours of what goes wrong, from three sides."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from pcore.cli.cameras import OrbitWish, orbit_of_cloud
from pcore.data.splat import point_picture
from pcore.editing.diagnosis import HOLE_LEGEND, STRAIN_LEGEND
from pcore.editing.handles import HANDLE_LEGEND
from pcore.evaluation.figures import png_bytes, sheet, with_legend
from pcore.files.atomic import write_atomically

VIEWS = 3
"""Evenly around the object, so that every side of it is seen by one."""


def write_picture(path: Path, points: Tensor, colors: Mapping[str, Tensor]) -> None:
    """Draw a sheet with a column for each colouring, a row for each view, and a legend.

    Args:
        path: a .png.
        points: (N, 3) where they are now, world units.
        colors: name of a colouring, of those with a legend -> (N, 3) uint8.
    """
    cameras = [camera for _, camera in orbit_of_cloud(points, OrbitWish(count=VIEWS))]
    rows = [
        (
            f"{number * 360 // VIEWS} degrees",
            [point_picture(points, paint, camera).numpy() for paint in colors.values()],
        )
        for number, camera in enumerate(cameras)
    ]
    page = sheet(list(colors), rows, cell=max(cameras[0].width, cameras[0].height))
    legends = {"strain": STRAIN_LEGEND, "holes": HOLE_LEGEND, "handles": HANDLE_LEGEND}
    page = with_legend(page, {name: legends[name] for name in colors})
    write_atomically(path, png_bytes(page))

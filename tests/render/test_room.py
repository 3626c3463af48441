"""The room that goes from rays to pixels stays small enough to be read."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path

import pcore.render.image
import pcore.render.picture
import pcore.render.raster
import pcore.render.surface
import pcore.render.tiles
import pcore.render.trace
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud

PATH = (
    pcore.render.trace,
    pcore.render.surface,
    pcore.render.tiles,
    pcore.render.raster,
    pcore.render.picture,
    pcore.render.image,
)
MOST_CLASSES = 12


def test_from_a_ray_to_its_pixel_there_are_twelve_classes() -> None:
    """All that the modules of the way define or import, and what a pose is made of."""
    met = {PointCloud, LocalMaps}
    for module in PATH:
        for value in vars(module).values():
            if inspect.isclass(value) and value.__module__.startswith("pcore."):
                met.add(value)
    classes = {one for one in met if not issubclass(one, Exception)}
    assert len(classes) <= MOST_CLASSES, sorted(one.__name__ for one in classes)


def test_tracing_is_one_file_of_short_functions() -> None:
    path = Path(inspect.getfile(pcore.render.trace))
    source = path.read_text()
    assert len(source.splitlines()) <= 300
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno + 1 <= 40, node.name

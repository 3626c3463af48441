"""Objects that the tests of the pages show."""

from functools import cache
from importlib.resources import as_file, files

import pcore
from pcore.asset.asset import Asset

TWIST = {
    "version": 2,
    "edits": [
        {"type": "twist", "axis": "z", "angle_deg": {"keyframes": [[0, 0], [1, 50]]}},
    ],
}


@cache
def demo() -> Asset:
    """The object of `pcore studio --demo`."""
    with as_file(files("pcore.studio").joinpath("demo_run")) as folder:
        return pcore.load(folder)

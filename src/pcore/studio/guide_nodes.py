"""Guides on the page: lines, and dots of a rim."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.studio.guides import Guides
from pcore.studio.page_frame import SIZE, PageFrame

_DOT = 0.004 * SIZE
_RIM = (38, 50, 56)
_WIDE = 2.0
"""Pixels of a line."""


class GuideNodes:
    """The nodes of a scene; those that stay as large are changed, not made anew."""

    def __init__(self, scene: Any, frame: PageFrame) -> None:
        """Begin with none.

        Args:
            scene: of viser.
            frame: where things are on the page.
        """
        self._scene, self._frame = scene, frame
        self._lines: Any = None
        self._rim: Any = None

    def show(self, guides: Guides) -> None:
        """Show these and no others."""
        lines = self._frame.to_page(guides.lines.numpy())
        colors = np.repeat(guides.colors.numpy()[:, None], 2, axis=1)
        if not _changed(self._lines, lines):
            self._lines = _gone(self._lines)
            if len(lines):
                self._lines = self._scene.add_line_segments(
                    "/guides/lines", lines, colors, thickness=_WIDE, thickness_units="screen"
                )
        elif not np.array_equal(self._lines.colors, colors):
            self._lines.colors = colors
        rim = self._frame.to_page(guides.rim.numpy())
        if not _changed(self._rim, rim):
            self._rim = _gone(self._rim)
            if len(rim):
                self._rim = self._scene.add_point_cloud(
                    "/guides/rim",
                    points=rim,
                    colors=_RIM,
                    point_size=_DOT,
                    point_shape="circle",
                    point_shading="flat",
                    precision="float32",
                )


def _changed(node: Any, places: NDArray[np.float32]) -> bool:
    """Give a node other places; whether it could be done."""
    if node is None or node.points.shape != places.shape:
        return False
    if not np.array_equal(node.points, places):
        node.points = places
    return True


def _gone(node: Any) -> None:
    if node is not None:
        node.remove()

"""What one tab of a page shows of the object: splats while things move, pictures at rest."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.asset.content import Color
from pcore.data.pictures import to_bytes
from pcore.gaussians.splats import Splats
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.studio.page_frame import PageFrame

MOST_PIXELS = 480_000
"""Of a picture at rest; tabs that are larger show it enlarged."""
_LEAST = 16
_FAR = 160.0
"""Depth on the page of what is not there; viser's code for depths ends at 167."""
_SLACK = 0.3
"""Depth on the page that handles may lie below the surface and still be seen."""
_OVERLAP = 0.12
"""Seconds that a picture stays behind splats that become visible."""
_QUALITY = 92
_DOT, _FOLD = 0.09, 0.22
"""Sizes of marks on the page."""
_FOLDED = (220, 30, 30)
_POINT = 0.6
"""Size of a point in spacings: marks of points are seen beside it."""


class Viewport:
    """The scene of one tab; all methods send messages and never wait for an answer."""

    def __init__(self, client: Any, frame: PageFrame, background: Color) -> None:
        """Begin with an empty scene.

        Args:
            client: of viser.
            frame: where things are on the page.
            background: behind the object.
        """
        self.client, self._frame = client, frame
        paint = [round(255 * one) for one in background]
        # A scene without a picture behind it is black once it had one.
        self._empty = np.array([[paint] * 2] * 2, dtype=np.uint8)
        client.scene.set_background_image(self._empty, format="png")
        self._splats: Any = None
        self._points: Any = None
        self._dots: Any = None
        self._folds: Any = None
        self._ink: Any = None
        self.drawn, self.dark, self._resting = False, False, False
        self._since: float | None = None

    @property
    def number(self) -> int:
        """Of the tab."""
        return int(self.client.client_id)

    def camera(self, *, most: int = MOST_PIXELS) -> Camera | None:
        """The tab's camera; None as long as its window has no size.

        Args:
            most: pixels of its pictures; with more the picture is smaller than the window.
        """
        eye = self.client.camera
        width, height = int(eye.image_width), int(eye.image_height)
        if min(width, height) < 1:
            return None
        share = min(1.0, (most / (width * height)) ** 0.5)
        return self._frame.camera(
            eye.position,
            eye.wxyz,
            float(eye.fov),
            max(_LEAST, round(width * share)),
            max(_LEAST, round(height * share)),
        )

    @property
    def eye(self) -> Tensor:
        """(3,) where the tab looks from, world units."""
        return torch.from_numpy(self._frame.to_world(self.client.camera.position)).float()

    def fit(self, eye: tuple[float, float, float]) -> None:
        """In a window that is higher than wide, step back until the object fits its width.

        Args:
            eye: (3,) on the page, where the object fits a window that is wide enough.
        """
        camera = self.client.camera
        away = int(camera.image_height) / max(int(camera.image_width), 1)
        if away > 1.0:
            camera.position = tuple(away * one for one in eye)

    def moving(self, *, stays: bool = False) -> None:
        """Show the splats or points that there are, at once.

        The picture before them stays for a moment: browsers sort splats that become visible first,
        and would show nothing meanwhile.

        Args:
            stays: no picture follows, and the one before goes at once.
        """
        now = time.monotonic()
        self.drawn = self.drawn or stays
        if self._resting:
            self._resting, self._since = False, now
            if self._shapes is not None:
                self._shapes.visible = True
        if self._since is not None and (stays or now > self._since + _OVERLAP):
            self._since = None
            self.client.scene.set_background_image(self._empty, format="png")

    def show_splats(self, splats: Splats) -> None:
        """Show other splats, in the place of points."""
        self._points = _gone(self._points)
        if self._splats is None:
            self._splats = self.client.scene.add_gaussian_splats(
                "/object",
                centers=self._frame.to_page(splats.centers),
                covariances=self._frame.shapes(splats),
                rgbs=splats.rgb,
                opacities=splats.opacities[:, None],
            )
        else:
            self._splats.buffer = self._frame.buffer(splats)

    def show_points(self, splats: Splats, spacing: float) -> None:
        """Show the centres of splats as points, in the place of splats.

        Args:
            splats: of which centres and colours count.
            spacing: of neighbours, world units; points are a share of it.
        """
        self._splats = _gone(self._splats)
        places = self._frame.to_page(splats.centers)
        colors = to_bytes(torch.from_numpy(splats.rgb)).numpy()
        if self._points is None:
            self._points = self.client.scene.add_point_cloud(
                "/points",
                points=places,
                colors=colors,
                point_size=_POINT * spacing * self._frame.scale,
                point_shape="circle",
                precision="float32",
                visible=not self._resting,
            )
        else:
            with self.client.atomic():
                self._points.points, self._points.colors = places, colors

    def show_picture(self, pixels: NDArray[np.uint8], depth: NDArray[np.float32] | None) -> None:
        """Show a picture of ours in the place of the splats."""
        self.drawn, self._resting, self._since = True, True, None
        with self.client.atomic():
            self.client.scene.set_background_image(
                pixels, format="jpeg", jpeg_quality=_QUALITY, depth=depth
            )
            if self._shapes is not None:
                self._shapes.visible = False

    @property
    def _shapes(self) -> Any:
        """The node that shows the object while it moves."""
        return self._splats or self._points

    def show_dots(self, points: Tensor, colors: Tensor, folds: Tensor) -> None:
        """Show coloured dots over the object, and other marks where space folds; (0, 3) for none.

        Marks of folds are larger and have corners: red dots would be like those of overlays.
        """
        self._dots = self._marked("/dots", self._dots, points, colors.numpy(), _DOT, "circle")
        self._folds = self._marked("/folds", self._folds, folds, _FOLDED, _FOLD, "diamond")

    def _marked(
        self, name: str, node: Any, points: Tensor, colors: Any, size: float, shape: Any
    ) -> Any:
        """Show marks in the place of those before, by their name: without a gap."""
        if not len(points):
            return _gone(node)
        places = self._frame.to_page(points.numpy())
        if self._points is not None:  # Its points are as large, and would cover the marks.
            away = np.asarray(self.client.camera.position, dtype=np.float32) - places
            away /= np.linalg.norm(away, axis=1, keepdims=True)
            places = places + self._points.point_size * away
        return self.client.scene.add_point_cloud(
            name,
            points=places,
            colors=colors,
            point_size=size,
            point_shape=shape,
            point_shading="flat",
            precision="float32",
        )

    def show_ink(self, segments: NDArray[np.float32] | None, color: tuple[int, int, int]) -> None:
        """Show lines (L, 2, 3), on the page, before everything; None for none."""
        if segments is None and self._ink is not None:
            self._ink.remove()
            self._ink = None
        elif self._ink is not None:
            self._ink.points = segments
        elif segments is not None:
            self._ink = self.client.scene.add_line_segments(
                "/ink", segments, color, thickness=2.0, thickness_units="screen"
            )


def _gone(node: Any) -> None:
    """Take a node away, if there is one."""
    if node is not None:
        node.remove()


def pixels_of(image: Image) -> NDArray[np.uint8]:
    """Colours (H, W, 3) of a picture."""
    return to_bytes(image.rgb).cpu().numpy()


def page_depth(image: Image, frame: PageFrame) -> NDArray[np.float32]:
    """Depths (H, W) of a picture on the page, by which handles hide behind the object."""
    depth = torch.where(image.alpha > 0.5, image.depth, torch.nan) * frame.scale
    return (
        torch.nan_to_num(depth, nan=_FAR)
        .add(_SLACK)
        .clamp(0.0, _FAR)
        .cpu()
        .numpy()
        .astype(np.float32)
    )


def side_by_side(
    left: NDArray[np.uint8], right: NDArray[np.uint8], share: float
) -> NDArray[np.uint8]:
    """The left part of one picture beside the right part of another, and a line between."""
    seam = round(share * left.shape[1])
    both = np.concatenate([left[:, :seam], right[:, seam:]], axis=1)
    if 0 < seam < both.shape[1]:
        both[:, max(0, seam - 1) : seam + 1] = (0, 150, 136)
    return both

"""Intrinsics of transforms files: fields of view, or focal lengths and principal point in pixels.

What a frame says goes before what stands at the top of the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor

from pcore.data.lens_entry import LensEntry
from pcore.errors import SceneError
from pcore.geometry.camera import Camera

_SAME = 0.01
_CUT = 10
"""How far outside of a cut picture its principal point may lie, in its own sizes."""
Otherwise = TypeVar("Otherwise", float, "float | None")


@dataclass(frozen=True, kw_only=True)
class Focal:
    """What is said about the focal length along one axis of the image; None is nothing.

    Attributes:
        pixels: of the full image.
        angle: field of view along that axis, radians.
    """

    pixels: float | None = None
    angle: float | None = None

    @property
    def is_given(self) -> bool:
        """Whether anything is said."""
        return self.pixels is not None or self.angle is not None


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Intrinsics as they are written; what is not said follows from the rest.

    Attributes:
        size: (width, height) of the full image in pixels, each None where it is not said.
        x: focal length along x; that along y when nothing is said.
        y: focal length along y; that along x when nothing is said.
        cx: principal point along x, pixels of the full image; the middle when None.
        cy: principal point along y; the middle when None.
    """

    size: tuple[int | None, int | None] = (None, None)
    x: Focal
    y: Focal
    cx: float | None = None
    cy: float | None = None

    @property
    def full_size(self) -> tuple[int, int] | None:
        """(width, height) of the full image where both are said."""
        width, height = self.size
        return None if width is None or height is None else (width, height)

    @property
    def in_pixels(self) -> bool:
        """Whether a number is in pixels, so that the size of the full image must be known."""
        return any(one is not None for one in (self.x.pixels, self.y.pixels, self.cx, self.cy))

    def replaced(self, frame: LensEntry, where: str) -> Lens:
        """Return this lens with what a frame says itself.

        Raises:
            SceneError: another size than that which the numbers in pixels belong to.
        """
        own = lens_of(frame, where)
        size = (frame.w or self.size[0], frame.h or self.size[1])
        keeps_x = not own.x.is_given
        keeps_y = keeps_x and not own.y.is_given
        lens = Lens(
            size=size,
            x=self.x if keeps_x else own.x,
            y=self.y if keeps_y else own.y,
            cx=_first(own.cx, self.cx),
            cy=_first(own.cy, self.cy),
        )
        kept = Lens(
            x=self.x if keeps_x else Focal(),
            y=self.y if keeps_y else Focal(),
            cx=self.cx if own.cx is None else None,
            cy=self.cy if own.cy is None else None,
        )
        if kept.in_pixels and self.full_size is not None and size != self.size:
            raise SceneError(
                f"{where}: is of {size[0]} x {size[1]} pixels, but takes numbers in pixels from "
                f"the top of the file, which are for {self.size[0]} x {self.size[1]}; give the "
                "frame its own 'fl_x', 'fl_y', 'cx' and 'cy'"
            )
        return lens

    def camera(
        self,
        world_from_camera: Tensor,
        size: tuple[int, int],
        full: tuple[int, int] | None,
        where: str,
    ) -> Camera:
        """Camera of a picture.

        Args:
            world_from_camera: (4, 4) pose.
            size: width and height of the picture.
            full: width and height that the numbers in pixels belong to; None where they are not
                known and not needed. A picture of another shape keeps the horizontal field of view.
            where: file and frame, for messages.

        Raises:
            SceneError: numbers that do not fit the full image or one another.
            InputError: a pose or field of view that no camera has.
        """
        if full is not None:
            self._check_vertical(full, where)
        if not self.in_pixels and self.x.angle is not None:
            return Camera.from_fov(
                world_from_camera, width=size[0], height=size[1], angle_x=self.x.angle
            )
        full = full or size
        focal_x, focal_y = self._focals(full, where)
        cx, cy = _first(self.cx, 0.5 * full[0]), _first(self.cy, 0.5 * full[1])
        # A picture that was cut says its own size, and the axis may lie outside of what was kept.
        room = 0 if self.full_size is None else _CUT
        if not all(abs(c / side - 0.5) <= 0.5 + room for c, side in ((cx, full[0]), (cy, full[1]))):
            raise SceneError(
                f"{where}: expected the principal point 'cx', 'cy' inside the image of {full[0]} x "
                f"{full[1]} pixels, got {cx:g}, {cy:g}; are they those of another image size?"
            )
        scale = size[0] / full[0]
        return Camera(
            world_from_camera=world_from_camera,
            width=size[0],
            height=size[1],
            fx=focal_x * scale,
            fy=focal_y * scale,
            cx=cx * scale,
            cy=0.5 * size[1] + (cy - 0.5 * full[1]) * scale,
        )

    def _focals(self, full: tuple[int, int], where: str) -> tuple[float, float]:
        """Focal lengths along x and y, pixels of the full image; pixels go before angles."""
        along_x = _focal(self.x, full, 0, where)
        along_y = self.y.pixels
        if along_x is None:
            along_x = _focal(self.y, full, 1, where)
        assert along_x is not None, "files without any are refused when they are read"
        return along_x, _first(along_y, along_x)

    def _check_vertical(self, full: tuple[int, int], where: str) -> None:
        """Refuse a vertical angle that contradicts the rest."""
        if self.y.angle is None:
            return
        seen = _focal(self.y, full, 1, where)  # Compared with fl_y there.
        along_x = _focal(self.x, full, 0, where)
        if self.y.pixels is None and along_x is not None and seen is not None:
            _check_square(along_x, seen, full, where)


def lens_of(entry: LensEntry, where: str) -> Lens:
    """Return the lens that the top of a file or a frame describes.

    Raises:
        SceneError: an angle in radians and one in degrees that differ.
    """
    return Lens(
        size=(entry.w, entry.h),
        x=Focal(pixels=entry.fl_x, angle=_angle(entry, "x", where)),
        y=Focal(pixels=entry.fl_y, angle=_angle(entry, "y", where)),
        cx=entry.cx,
        cy=entry.cy,
    )


def _angle(entry: LensEntry, axis: str, where: str) -> float | None:
    """Field of view in radians, from either of the two keys."""
    radians: float | None = getattr(entry, f"camera_angle_{axis}")
    degrees: float | None = getattr(entry, f"{axis}_fov")
    if degrees is None:
        return radians
    if radians is not None and not abs(math.radians(degrees) / radians - 1) <= _SAME:
        raise SceneError(
            f"{where}: expected '{axis}_fov' in degrees to be the 'camera_angle_{axis}' of "
            f"{radians:g} radians, got {degrees:g}; remove the wrong one"
        )
    return math.radians(degrees) if radians is None else radians


def _focal(said: Focal, full: tuple[int, int], axis: int, where: str) -> float | None:
    """Focal length in pixels along an axis (0 is x, 1 is y); None where nothing is said."""
    if said.angle is None:
        return said.pixels
    name = "xy"[axis]
    if not 0 < said.angle < math.pi:
        raise SceneError(
            f"{where}: expected 'camera_angle_{name}' between 0 and pi radians, got {said.angle}"
        )
    seen = 0.5 * full[axis] / math.tan(0.5 * said.angle)
    if said.pixels is not None and not abs(said.pixels / seen - 1) <= _SAME:
        raise SceneError(
            f"{where}: 'camera_angle_{name}' and images of {full[0]} x {full[1]} pixels expect "
            f"'fl_{name}' {seen:.6g}, got {said.pixels:.6g}; scale fl_x, fl_y, cx and cy as the "
            "images were scaled, or remove what is wrong"
        )
    return _first(said.pixels, seen)


def _check_square(along_x: float, along_y: float, full: tuple[int, int], where: str) -> None:
    """Refuse angles that make pixels other than square, which Blender's `angle_y` does."""
    if not abs(along_y / along_x - 1) <= _SAME:
        raise SceneError(
            f"{where}: with images of {full[0]} x {full[1]} pixels the vertical angle means pixels "
            f"{along_x / along_y:.3g} times as high as wide; remove 'camera_angle_y' if they are "
            "square (Blender's angle_y is that of its sensor), or give 'fl_x' and 'fl_y' if not"
        )


def _first(given: float | None, otherwise: Otherwise) -> float | Otherwise:
    return otherwise if given is None else given

"""Intrinsics of transforms files: a field of view, or focal lengths and principal point in pixels.

The keys are those of the tools that write such files beside Blender (instant-ngp, nerfstudio).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from pcore.errors import SceneError
from pcore.geometry.camera import Camera

Number = Annotated[float, Field(strict=True)]
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
_SAME_FOCAL = 0.01
Otherwise = TypeVar("Otherwise", float, "float | None")


class LensEntry(BaseModel):
    """The keys about the lens, which stand at the top of the file or in a frame."""

    model_config = ConfigDict(extra="ignore")
    fl_x: Number | None = None
    fl_y: Number | None = None
    cx: Number | None = None
    cy: Number | None = None
    k1: Number | None = None
    k2: Number | None = None
    k3: Number | None = None
    k4: Number | None = None
    p1: Number | None = None
    p2: Number | None = None
    is_fisheye: bool | None = None
    camera_model: str | None = None


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Intrinsics as they are written; what is None follows from the others.

    Attributes:
        angle_x: horizontal field of view, radians.
        fl_x: focal length along x, pixels of the full image; from `angle_x` when None.
        fl_y: focal length along y; that along x when None.
        cx: principal point along x; the middle when None.
        cy: principal point along y; the middle when None.
    """

    angle_x: float | None
    fl_x: float | None = None
    fl_y: float | None = None
    cx: float | None = None
    cy: float | None = None

    @property
    def in_pixels(self) -> bool:
        """Whether a number is in pixels, so that the size of the full image must be known."""
        return any(one is not None for one in (self.fl_x, self.fl_y, self.cx, self.cy))

    def replaced(self, frame: LensEntry) -> Lens:
        """Return this lens with what a frame says itself."""
        return Lens(
            angle_x=self.angle_x if frame.fl_x is None else None,
            fl_x=_first(frame.fl_x, self.fl_x),
            fl_y=_first(frame.fl_y, self.fl_y if frame.fl_x is None else None),
            cx=_first(frame.cx, self.cx),
            cy=_first(frame.cy, self.cy),
        )

    def camera(
        self, world_from_camera: Tensor, size: tuple[int, int], full: tuple[int, int], where: str
    ) -> Camera:
        """Camera of a picture.

        Args:
            world_from_camera: (4, 4) pose.
            size: width and height of the picture.
            full: width and height that the numbers in pixels belong to. A picture of another
                shape keeps the horizontal field of view.
            where: file and frame, for messages.

        Raises:
            SceneError: numbers that do not fit the full image or one another.
            InputError: a pose or field of view that no camera has.
        """
        if not self.in_pixels and self.angle_x is not None:
            return Camera.from_fov(
                world_from_camera, width=size[0], height=size[1], angle_x=self.angle_x
            )
        focal = self._focal(world_from_camera, full, where)
        cx, cy = _first(self.cx, 0.5 * full[0]), _first(self.cy, 0.5 * full[1])
        if not (0 <= cx <= full[0] and 0 <= cy <= full[1]):
            raise SceneError(
                f"{where}: expected the principal point 'cx', 'cy' inside the image of {full[0]} x "
                f"{full[1]} pixels, got {cx:g}, {cy:g}; are they those of another image size?"
            )
        scale = size[0] / full[0]
        return Camera(
            world_from_camera=world_from_camera,
            width=size[0],
            height=size[1],
            fx=focal * scale,
            fy=_first(self.fl_y, focal) * scale,
            cx=cx * scale,
            cy=0.5 * size[1] + (cy - 0.5 * full[1]) * scale,
        )

    def _focal(self, pose: Tensor, full: tuple[int, int], where: str) -> float:
        """Focal length along x, pixels of the full image."""
        if self.angle_x is None:
            assert self.fl_x is not None, "files without either are refused when they are read"
            return self.fl_x
        camera = Camera.from_fov(pose, width=full[0], height=full[1], angle_x=self.angle_x)
        seen = camera.focal[0]
        if self.fl_x is not None and not abs(self.fl_x / seen - 1) <= _SAME_FOCAL:
            raise SceneError(
                f"{where}: 'camera_angle_x' and images of {full[0]} x {full[1]} pixels expect "
                f"'fl_x' {seen:.6g}, got {self.fl_x:.6g}; scale fl_x, fl_y, cx and cy as the "
                "images were scaled, or remove what is wrong"
            )
        return _first(self.fl_x, seen)


def check_undistorted(entry: LensEntry, where: str) -> None:
    """Refuse lenses that bend straight lines: a ray per pixel is computed without that.

    Raises:
        SceneError: names the coefficient and its value.
    """
    values = {name: getattr(entry, name) for name in _DISTORTION}
    bad = [f"{name} = {value:g}" for name, value in values.items() if value]
    if entry.is_fisheye or "FISHEYE" in (entry.camera_model or "").upper():
        bad.append("a fisheye lens")
    if bad:
        raise SceneError(
            f"{where}: expected images of a pinhole camera (all of {', '.join(_DISTORTION)} zero), "
            f"got {', '.join(bad)}; undistort the images (COLMAP: image_undistorter) and write "
            "the intrinsics of the new ones"
        )


def lens_of(entry: LensEntry, angle_x: float | None) -> Lens:
    """Return the lens that a file describes at its top."""
    return Lens(angle_x=angle_x, fl_x=entry.fl_x, fl_y=entry.fl_y, cx=entry.cx, cy=entry.cy)


def _first(given: float | None, otherwise: Otherwise) -> float | Otherwise:
    return otherwise if given is None else given

"""Pinhole cameras: OpenGL axes (x right, y up, looking along -z), pixel centres at +0.5."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from numbers import Integral

import torch
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.camera_checks import check_kind, check_pose
from pcore.geometry.rays import RayBundle
from pcore.geometry.rotation import rotations

Number = float | Tensor
"""A number, or a tensor () that autograd may follow; (C,) of a batch of cameras."""


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera, or a batch of C that take pictures of one size.

    Rays and depths are differentiable in the pose, the focal lengths and the principal point, and
    have the pose's dtype and device.

    Attributes:
        world_from_camera: (4, 4) or (C, 4, 4), float32 or float64, rigid; maps camera space to
            world space.
        width: image width in pixels.
        height: image height in pixels.
        fx: focal length along x in pixels.
        fy: focal length along y in pixels.
        cx: principal point along x in pixels (`width / 2` is the image centre).
        cy: principal point along y in pixels.
    """

    world_from_camera: Tensor
    width: int
    height: int
    fx: Number
    fy: Number
    cx: Number
    cy: Number

    def __post_init__(self) -> None:
        check_kind(self.world_from_camera)
        batch = tuple(self.world_from_camera.shape[:-2])
        for name, one in self._numbers.items():
            if isinstance(one, Tensor) and tuple(one.shape) not in ((), batch):
                raise InputError(
                    f"camera: expected {name} as a number{' or one of each camera' * bool(batch)}, "
                    f"got a tensor of shape {tuple(one.shape)}"
                )
        if self.world_from_camera.ndim == 3 and len(self.world_from_camera):
            for one in self:  # Each is checked by itself.
                _ = one
            return
        check_pose(self.world_from_camera)
        if not all(isinstance(side, Integral) and side > 0 for side in (self.width, self.height)):
            raise InputError(
                f"camera: expected a positive image size, got {self.width} x {self.height} pixels"
            )
        fx, fy, cx, cy = (_value(one) for one in self._numbers.values())
        if not (min(fx, fy) > 0 and math.isfinite(fx + fy)):
            raise InputError(f"camera: expected positive focal lengths in pixels, got {fx}, {fy}")
        if not math.isfinite(cx + cy):
            raise InputError(f"camera: expected a finite principal point in pixels, got {cx}, {cy}")

    @classmethod
    def stack(cls, cameras: Sequence[Camera]) -> Camera:
        """Make a batch of single cameras.

        Raises:
            InputError: no camera, a batch among them, or pictures of different sizes.
        """
        sizes = {(one.width, one.height) for one in cameras}
        if len(sizes) != 1 or any(one.count is not None for one in cameras):
            listed = ", ".join(f"{width} x {height}" for width, height in sorted(sizes))
            raise InputError(
                "cameras: expected a batch of single cameras of one image size, got "
                f"{listed or 'none'}; render those of each size by themselves"
            )
        poses = torch.stack([one.world_from_camera for one in cameras])
        numbers = {
            name: torch.stack([torch.as_tensor(one._numbers[name]).to(poses) for one in cameras])
            for name in cameras[0]._numbers
        }
        return replace(cameras[0], world_from_camera=poses, **numbers)

    @property
    def count(self) -> int | None:
        """C of a batch; None of a single camera."""
        return None if self.world_from_camera.ndim == 2 else len(self.world_from_camera)

    def __iter__(self) -> Iterator[Camera]:
        """Go through the cameras of a batch; a single camera is one."""
        if self.count is None:
            yield self
        for index in range(self.count or 0):
            numbers = {
                name: one[index] if isinstance(one, Tensor) and one.ndim else one
                for name, one in self._numbers.items()
            }
            yield replace(self, world_from_camera=self.world_from_camera[index], **numbers)

    @property
    def _numbers(self) -> dict[str, Number]:
        return {"fx": self.fx, "fy": self.fy, "cx": self.cx, "cy": self.cy}

    @property
    def focal(self) -> tuple[float, float]:
        """Focal lengths of a single camera along x and y in pixels, as numbers."""
        return _value(self.fx), _value(self.fy)

    @property
    def asks_gradient(self) -> bool:
        """Whether autograd follows the pose or one of the numbers."""
        parts = [self.world_from_camera, *self._numbers.values()]
        followed = (isinstance(one, Tensor) and one.requires_grad for one in parts)
        return torch.is_grad_enabled() and any(followed)

    @classmethod
    def from_fov(
        cls, world_from_camera: Tensor, *, width: int, height: int, angle_x: float
    ) -> Camera:
        """Camera with square pixels from the horizontal field of view in radians."""
        if not 0 < angle_x < math.pi:
            raise InputError(
                "camera: expected a horizontal field of view between 0 and pi radians, "
                f"got {angle_x}"
            )
        focal = 0.5 * width / math.tan(0.5 * angle_x)
        return cls(
            world_from_camera=world_from_camera,
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=0.5 * width,
            cy=0.5 * height,
        )

    @classmethod
    def from_view(
        cls, position: Tensor, wxyz: Tensor, fov_y: float, *, width: int, height: int
    ) -> Camera:
        """Camera with square pixels as viewers describe theirs, such as viser.

        Args:
            position: (3,) world units.
            wxyz: (4,) quaternion of `world_from_camera` with OpenCV axes: y down, looking along +z.
            fov_y: vertical field of view, radians.
            width: in pixels.
            height: in pixels.

        Raises:
            InputError: a field of view of nothing or of all there is, or a quaternion of length 0.
        """
        if not 0 < fov_y < math.pi:
            raise InputError(
                f"camera: expected a vertical field of view between 0 and pi radians, got {fov_y}"
            )
        turn = rotations(torch.as_tensor(wxyz).double()) * torch.tensor([1.0, -1.0, -1.0])
        pose = torch.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, torch.as_tensor(position)
        angle_x = 2 * math.atan(math.tan(0.5 * fov_y) * width / height)
        return cls.from_fov(pose, width=width, height=height, angle_x=angle_x)

    def cropped(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return the camera of a rectangle of the picture, pixels."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    @property
    def center(self) -> Tensor:
        """(3,) or (C, 3) the centre in world units."""
        return self.world_from_camera[..., :3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """Return the same camera with another image size (intrinsics scaled along)."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )

    def moved(self, world_from_camera: Tensor) -> Camera:
        """Return the same intrinsics at another pose."""
        return replace(self, world_from_camera=world_from_camera)

    def rays(
        self,
        top: int = 0,
        left: int = 0,
        height: int | None = None,
        width: int | None = None,
        *,
        places: Tensor | None = None,
    ) -> RayBundle:
        """Rays through the pixels of a rectangle, the whole image by default.

        Args:
            top: first row.
            left: first column.
            height: rows; None takes all down to the image's end.
            width: columns; None takes all to the image's end.
            places: (S, 2) or (height, width, S, 2) column and row within a pixel, 0 to 1, of S rays
                per pixel (`pixel_samples`); None sends one through every pixel's centre.

        Returns:
            (height, width) rays with unit directions, world units; (height, width, S) with places;
            of a batch of cameras with C in front.
        """
        if self.count is not None:
            each = [one.rays(top, left, height, width, places=places) for one in self]
            return replace(
                each[0],
                origins=torch.stack([one.origins for one in each]),
                directions=torch.stack([one.directions for one in each]),
            )
        pose = self.world_from_camera
        last_column = self.width if width is None else left + width
        last_row = self.height if height is None else top + height
        columns = torch.arange(left, last_column, dtype=pose.dtype, device=pose.device)
        rows = torch.arange(top, last_row, dtype=pose.dtype, device=pose.device)
        row, column = torch.meshgrid(rows, columns, indexing="ij")
        if places is None:
            row, column = row + 0.5, column + 0.5
        else:
            inside = places.to(pose)
            row, column = row[..., None] + inside[..., 1], column[..., None] + inside[..., 0]
        grid_x, grid_y = (column - self.cx) / self.fx, -(row - self.cy) / self.fy
        in_camera = torch.stack([grid_x, grid_y, -torch.ones_like(grid_x)], dim=-1)
        directions = in_camera @ pose[:3, :3].T
        directions = directions / directions.norm(dim=-1, keepdim=True)
        return RayBundle(
            origins=self.center.expand_as(directions),
            directions=directions,
            samples=None if places is None else places.shape[-2],
        )

    def pixel_width(self, place: Tensor) -> float:
        """How wide a pixel is as far away as a place (3,), world units."""
        return float((self.center - place).detach().norm()) / self.focal[0]

    def project(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Column, row and camera z (N,) of world points (N, 3); of a batch of cameras (C, N).

        Columns and rows count from the picture's corner, pixels wide; those of points that are not
        in front of the camera mean nothing.
        """
        if self.count is not None:
            each = zip(*(one.project(points) for one in self), strict=True)
            column, row, depth = map(torch.stack, each)
            return column, row, depth
        pose = self.world_from_camera.to(points)
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        depth = -local[:, 2]
        column = local[:, 0] / depth * self.fx + self.cx
        row = -local[:, 1] / depth * self.fy + self.cy
        return column, row, depth

    def depth(self, points: Tensor) -> Tensor:
        """Camera z of world points (..., 3): distance along the viewing axis, world units.

        Of a batch of cameras the points are (C, ..., 3).
        """
        if self.count is not None:
            each = zip(self, points, strict=True)
            return torch.stack([camera.depth(seen) for camera, seen in each])
        forward = -self.world_from_camera[:3, 2].to(points)
        if not self.asks_gradient:
            return (points - self.center.to(points)) @ forward
        # What NaN says of the viewing axis would be NaN for all.
        unknown = points.isnan().any(dim=-1, keepdim=True)
        depth = (points.masked_fill(unknown, 0.0) - self.center.to(points)) @ forward
        return depth.masked_fill(unknown.squeeze(-1), math.nan)


def _value(number: Number) -> float:
    return float(torch.as_tensor(number).detach())

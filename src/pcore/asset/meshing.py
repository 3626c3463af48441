"""The surface of an object as a mesh, and that mesh under an edit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import MovedPoints
from pcore.asset.posing import Edit, bind_motion
from pcore.asset.standing import standing_of
from pcore.deform.base import Deformation, Identity
from pcore.deform.scattered import PointMotion
from pcore.errors import InputError
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_around
from pcore.geometry.surface_mesh import SurfaceMesh, parts_of, vertex_normals
from pcore.render.fusion import DepthView, depth_view, fuse
from pcore.render.mesh_colors import surface_colors
from pcore.validation import check_count

_VIEWS = 60
_COARSEST, _FINEST, _LARGEST = 8, 200, 1000
_VOXELS_PER_PIXEL = 2.0
"""Views from all around tell a little more than one; beyond that a mesh only has more triangles."""
_STRAY = 0.001
"""Share of the points, on either side of every axis, that do not count for the box."""
_MARGIN = 0.06
"""Of the longest side of the box: points lie within the object, and it has a surface."""
_LARGEST_PICTURE = 1600
_CRUMB = 0.01
"""Parts with less than this share of the triangles are what pictures disagree on."""
_ELEVATIONS = (-60.0, -25.0, 0.0, 25.0, 60.0)

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Meshing:
    """How a mesh is made.

    Attributes:
        resolution: voxels along the longest side of the box; None: two for every pixel that the
            photos show it with, at most 200.
        closed: close the surface where no camera has looked, so that it can be printed.
        box: lower and upper corner (3,) of what is meshed, world units; None: the
            object's points, without those of a background.
        smooth: see `fuse`, voxels.
        crumbs: keep parts that are smaller than a hundredth of all.
    """

    resolution: int | None = None
    smooth: float = 1.0
    closed: bool = False
    box: tuple[Tensor, Tensor] | None = None
    crumbs: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Meshed:
    """A mesh and the pictures that it was made of.

    Attributes:
        mesh: the surface at rest.
        views: the pictures.
        voxel: side of a voxel, world units.
        crumbs: how many small parts were left out.
    """

    mesh: SurfaceMesh
    views: tuple[DepthView, ...]
    voxel: float
    crumbs: int


def mesh_of(
    asset: Asset,
    cameras: Sequence[Camera] | None = None,
    how: Meshing | None = None,
    *,
    progress: Progress | None = None,
) -> Meshed:
    """Make the mesh of an object at rest out of its own pictures.

        meshed = mesh_of(asset, [view.camera for view in asset.scene().split("train")])

    Args:
        asset: the object; its device draws.
        cameras: where to look from, those of its photos; at most 60 of them are taken, cut and
            enlarged to the box. None looks from all around, also at what no photo shows.
        how: resolution, closed or not.
        progress: told (pictures taken, pictures in all).

    Raises:
        InputError: nothing solid is to be seen, or a resolution below 8 or above 1,000.
        DependencyError: scikit-image is not installed.
    """
    how = how or Meshing()
    lower, upper = object_box(asset) if how.box is None else how.box
    resolution = how.resolution
    if resolution is None:
        resolution = resolution_for(cameras, lower, upper)
    check_count("mesh: resolution", resolution, minimum=_COARSEST)
    if resolution > _LARGEST:
        raise InputError(
            f"mesh: expected a resolution of at most {_LARGEST} voxels along the longest side, got "
            f"{resolution}, whose grid would not fit into memory"
        )
    if not 0 <= how.smooth < resolution:
        raise InputError(f"mesh: expected a smoothing of 0 voxels or more, got {how.smooth}")
    voxel = float((upper - lower).max()) / resolution
    views = pictures_of(asset, cameras, (lower, upper), voxel, progress=progress)
    vertices, faces = fuse(views, lower, upper, voxel, smooth=how.smooth, closed=how.closed)
    crumbs = 0
    if not how.crumbs:
        vertices, faces, crumbs = _without_crumbs(vertices, faces)
    colors = surface_colors(vertices, vertex_normals(vertices, faces), views, voxel)
    mesh = SurfaceMesh(vertices=vertices, faces=faces, colors=colors)
    return Meshed(mesh=mesh, views=views, voxel=voxel, crumbs=crumbs)


def resolution_for(cameras: Sequence[Camera] | None, lower: Tensor, upper: Tensor) -> int:
    """Voxels along a box that photos can tell apart: two for every pixel, at most 200.

    Args:
        cameras: of the photos; None: not known.
        lower: (3,) corner of the box, world units.
        upper: (3,) the other corner.
    """
    middle = ((lower + upper) / 2).float()
    widths = [width for one in cameras or () if (width := one.pixel_width(middle)) > 0]
    if not widths:
        return _FINEST
    side = float((upper - lower).max())
    return min(max(math.ceil(_VOXELS_PER_PIXEL * side / median(widths)), _COARSEST), _FINEST)


def pictures_of(
    asset: Asset,
    cameras: Sequence[Camera] | None,
    box: tuple[Tensor, Tensor],
    pixel: float,
    *,
    progress: Progress | None = None,
) -> tuple[DepthView, ...]:
    """Take pictures of an object at rest, cut to a box.

    Args:
        asset: the object.
        cameras: see `mesh_of`.
        box: lower and upper corner (3,), world units.
        pixel: width of a pixel in the middle of the box, world units.
        progress: told (pictures taken, pictures in all).
    """
    if cameras is None:
        cameras = cameras_around(*box)
    chosen = [cameras[k] for k in sorted({len(cameras) * k // _VIEWS for k in range(_VIEWS)})]
    black, views = asset.over((0.0, 0.0, 0.0)), list[DepthView]()
    for number, camera in enumerate(chosen, start=1):
        closer = looking_at_box(camera, *box, pixel)
        if closer is not None:
            views.append(depth_view(black.render(None, closer, fast=True).cpu(), closer))
        if progress is not None:
            progress(number, len(chosen))
    return tuple(views)


def map_of(asset: Asset, edit: Edit | None, *, time: float | None = None) -> Deformation:
    """Return the map of space that an edit, bound to an object's points, is.

    Args:
        asset: the object.
        edit: see `Asset.pose`.
        time: for an edit file with keyframes.

    Raises:
        EditError: the edit is not valid, does not fit the points or folds space.
    """
    bound = bind_motion(edit, asset.points, lambda: asset.rig, time=time, aware=True)
    if bound.motion is None:
        return Identity()
    if isinstance(bound.motion, MovedPoints):
        maps = bound.motion.local_maps
        linear = None if maps is None else torch.linalg.inv(maps.to_rest.double())
        return PointMotion(asset.points, bound.motion.positions, linear)
    return bound.motion


def moved_mesh(mesh: SurfaceMesh, deformation: Deformation) -> SurfaceMesh:
    """Return the mesh with its vertices moved in double precision; faces and order stay."""
    with torch.no_grad():
        return mesh.moved(deformation(mesh.vertices))


def object_box(asset: Asset) -> tuple[Tensor, Tensor]:
    """Lower and upper corner (3,) of a box around an object, without what stands around it."""
    return box_of(asset.points[standing_of(asset).body(asset.points)])


def box_of(points: Tensor) -> tuple[Tensor, Tensor]:
    """Lower and upper corner (3,) of a box around points (N, 3) without strays, with a margin."""
    places = points.detach().cpu().double().numpy()
    ends = torch.from_numpy(np.quantile(places, (_STRAY, 1 - _STRAY), axis=0))
    slack = _MARGIN * float((ends[1] - ends[0]).max())
    if not slack > 0:
        raise InputError("mesh: expected points that extend in space, got all in one place")
    return ends[0] - slack, ends[1] + slack


def cameras_around(lower: Tensor, upper: Tensor) -> list[Camera]:
    """Cameras all around a box between corners (3,), all of which they see, above and below."""
    corners = corners_of(lower, upper)
    return [
        camera
        for elevation in _ELEVATIONS
        for camera in orbit_around(corners, 12, elevation=math.radians(elevation))
    ]


def corners_of(lower: Tensor, upper: Tensor) -> Tensor:
    """Corners (8, 3) float32 of a box."""
    return torch.cartesian_prod(*torch.stack([lower, upper]).float().unbind(dim=1))


def looking_at_box(camera: Camera, lower: Tensor, upper: Tensor, voxel: float) -> Camera | None:
    """The same camera cut to a box, with pixels a voxel wide there; None where it sees nothing."""
    corners = corners_of(lower, upper)
    middle = corners.mean(dim=0)
    column, row, depth = camera.project(corners)
    left, top, right, bottom = 0.0, 0.0, float(camera.width), float(camera.height)
    if bool((depth > 0).all()):
        left, right = max(left, float(column.min())), min(right, float(column.max()))
        top, bottom = max(top, float(row.min())), min(bottom, float(row.max()))
    elif bool((depth <= 0).all()):
        return None
    if right - left < 1 or bottom - top < 1:
        return None
    zoom = camera.pixel_width(middle) / voxel
    zoom = min(zoom, _LARGEST_PICTURE / max(right - left, bottom - top))
    width, height = (max(8, math.ceil(zoom * side)) for side in (right - left, bottom - top))
    return replace(
        camera,
        width=width,
        height=height,
        fx=zoom * camera.fx,
        fy=zoom * camera.fy,
        cx=zoom * (camera.cx - left),
        cy=zoom * (camera.cy - top),
    )


def _without_crumbs(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor, int]:
    """Leave out small parts of a mesh; also how many they were."""
    count, part = parts_of(len(vertices), faces.numpy())
    part_of_face = torch.from_numpy(part).long()[faces[:, 0]]
    sizes = torch.bincount(part_of_face, minlength=count)
    kept = sizes >= _CRUMB * sizes.sum()
    kept[sizes.argmax()] = True
    used, numbers = torch.unique(faces[kept[part_of_face]], return_inverse=True)
    return vertices[used], numbers, int((~kept).sum())

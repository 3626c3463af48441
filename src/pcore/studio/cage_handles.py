"""Handles of an edit by a mesh: its vertices, where there are few."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pcore.data.mesh_output import save_mesh
from pcore.data.meshes import MeshFile, read_mesh
from pcore.deform.box_cage import box_cage
from pcore.deform.cage import Cage
from pcore.editing.dragging import Mirror
from pcore.editing.script import parse_one
from pcore.editing.shapes import MeshPair
from pcore.errors import EditError
from pcore.geometry.point_cloud import extent_of
from pcore.geometry.surface_mesh import SurfaceMesh
from pcore.studio.handle_pose import HandlePose, triple, way_of

KINDS = ("cage", "mesh")
MOST = 200
"""Vertices of a mesh that is shown with handles; finer ones are for other programs."""
_SAME = 1e-9
_MARGIN = 0.08
"""How far a box stands off, in shares of the longest side."""
_GREY = 0.6


def loose_box(points: Tensor, cells: int) -> Cage:
    """A box around points (N, 3), world units, of so many cells along its longest side.

    Raises:
        EditError: all points are in one place.
    """
    lower, upper = (one.double() for one in extent_of(points))
    longest = float((upper - lower).max())
    if not longest > 0:
        raise EditError("cage: expected points that extend in space, got all in one place")
    margin = _MARGIN * longest
    sides = (upper - lower + 2 * margin).tolist()
    x, y, z = (max(1, round(cells * side / max(sides))) for side in sides)
    return box_cage(lower - margin, upper + margin, (x, y, z))


def write_cage(file: Path, cage: Cage) -> list[list[float]]:
    """Write a cage, and return its vertices as they read back.

    Raises:
        InputError: the file cannot be written.
    """
    grey = torch.full_like(cage.vertices, _GREY)
    save_mesh(file, SurfaceMesh(vertices=cage.vertices, faces=cage.faces, colors=grey))
    return read_mesh(file).vertices.double().tolist()


def cage_shapes(raw: dict[str, Any]) -> tuple[MeshFile, Tensor] | None:
    """The mesh at rest and its vertices (V, 3) now; None where they are too many to drag.

    Args:
        raw: the edit, without keyframes, of a kind of `KINDS`.
    """
    before, after = _meshes(raw)
    if len(before.vertices) > MOST:
        return None
    amount = float(raw.get("amount", 1.0))
    return before, torch.lerp(before.vertices.double(), after.vertices.double(), amount)


def cage_handles(raw: dict[str, Any]) -> list[HandlePose]:
    """Where the vertices are; none where they are too many to drag."""
    shapes = cage_shapes(raw)
    if shapes is None:
        return []
    rest = (shapes[1] - shapes[0].vertices).norm(dim=1) <= _SAME
    return [
        HandlePose(place=(x, y, z), rests=still)
        for (x, y, z), still in zip(shapes[1].tolist(), rest.tolist(), strict=True)
    ]


def with_vertex(
    raw: dict[str, Any], number: int, before: HandlePose, after: HandlePose
) -> dict[str, Any]:
    """Return an edit with one vertex moved; all of them then stand in the edit itself.

    Args:
        raw: the edit, without keyframes.
        number: of the vertex.
        before: where it is shown.
        after: where it is to be.
    """
    vertices = _vertices(raw)
    vertices[number] += way_of(raw, before, after)
    return {**raw, "after": vertices.tolist()}


def with_image(
    raw: dict[str, Any], number: int, mirror: Mirror, tolerance: float
) -> dict[str, Any]:
    """Return an edit in which the vertex on the other side does what one vertex does.

    Args:
        raw: the edit, without keyframes.
        number: of the vertex that leads.
        mirror: the plane between the sides.
        tolerance: how far from the image of its place the other one may be, world units.
    """
    vertices, rest = _vertices(raw), _rest(raw)
    if abs(mirror.distance(rest[number])) <= tolerance:
        return raw
    away = (rest - triple(mirror.image(rest[number]))).norm(dim=1)
    other = int(away.argmin())
    if other == number or float(away[other]) > tolerance:
        return raw
    vertices[other] = triple(mirror.image(vertices[number]))
    return {**raw, "after": vertices.tolist()}


def without_vertex(raw: dict[str, Any], number: int) -> dict[str, Any]:
    """Return an edit with one vertex where it was at rest."""
    vertices = _vertices(raw)
    vertices[number] = _rest(raw)[number]
    return {**raw, "after": vertices.tolist()}


def moved_vertices(raw: dict[str, Any]) -> list[int]:
    """Numbers of the vertices that are not at rest."""
    return [number for number, one in enumerate(cage_handles(raw)) if not one.rests]


def _vertices(raw: dict[str, Any]) -> Tensor:
    return _meshes(raw)[1].vertices.double().clone()


def _rest(raw: dict[str, Any]) -> Tensor:
    return _meshes(raw)[0].vertices.double()


def _meshes(raw: dict[str, Any]) -> tuple[MeshFile, MeshFile]:
    edit = parse_one(raw)
    assert isinstance(edit, MeshPair)
    return edit.meshes()

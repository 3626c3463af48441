"""Cages: a closed mesh around the object that is moved, and space that goes along with it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pcore.deform.base import Deformation, check_points, frozen_tensor
from pcore.deform.mean_value import carried, slopes_at, topology, weights_at, winding_numbers
from pcore.deform.sites import sites_of
from pcore.errors import InputError

FloatArray = NDArray[np.float64]
_MOST_SLOPES = 5_300_000
"""Pairs of a point and a vertex up to which slopes are kept: 64 MB."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cage:
    """A closed triangle mesh.

    Attributes:
        vertices: (V, 3) world units.
        faces: (F, 3) int64 vertex numbers, all turned the same way (outward or inward).
    """

    vertices: Tensor
    faces: Tensor
    _arrays: tuple[Any, Any, Any, Any, Any] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        vertices = frozen_tensor("cage vertices", self.vertices, (len(self.vertices), 3))
        faces = self.faces.detach().cpu().to(torch.int64).clone()
        _check_faces(vertices, faces)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        corners = np.ascontiguousarray(faces.numpy())
        edges, opposite, sense = topology(corners)
        arrays = (vertices.numpy(), corners, edges, opposite, sense)
        object.__setattr__(self, "_arrays", arrays)

    def bind(self, points: Tensor) -> CageBinding:
        """Compute the coordinates of points (N, 3) once, for many shapes of the cage."""
        check_points(points)
        flat = np.ascontiguousarray(points.detach().cpu().double().numpy().reshape(-1, 3))
        weights = torch.from_numpy(weights_at(flat, *self._arrays)).T
        return CageBinding(cage=self, points=points.detach(), weights=weights)

    def holds(self, points: Tensor) -> Tensor:
        """Which points (N, 3) lie inside: bool (N,)."""
        check_points(points)
        flat = np.ascontiguousarray(points.detach().cpu().double().numpy().reshape(-1, 3))
        turns = winding_numbers(flat, self._arrays[0], self._arrays[1])
        return torch.from_numpy(np.abs(turns) > 0.5)

    def slopes(self, points: Tensor) -> Tensor:
        """Derivatives (V, N, 3) float32 of the coordinates of points (N, 3) by position."""
        flat = np.ascontiguousarray(points.detach().cpu().double().numpy())
        return torch.from_numpy(slopes_at(flat, *self._arrays))

    def carry(self, points: Tensor, moves: FloatArray, *, slope: bool) -> tuple[Tensor, Tensor]:
        """Displacements (N, 3) and, if wanted, their derivatives (N, 3, 3) at points (N, 3)."""
        flat = np.ascontiguousarray(points.detach().cpu().double().numpy())
        way, turn = carried(flat, *self._arrays, moves, slope)
        return torch.from_numpy(way), torch.from_numpy(turn)


@dataclass(frozen=True, kw_only=True, eq=False)
class CageBinding:
    """Points with their coordinates in a cage: moving them is one product of matrices.

    Attributes:
        cage: the cage at rest.
        points: (N, 3) world units.
        weights: (N, V) float32 mean value coordinates, rows sum to 1; one vertex after the other in
            memory, since a product with few columns takes half the time then.
    """

    cage: Cage
    points: Tensor
    weights: Tensor

    @cached_property
    def _slopes(self) -> Tensor | None:
        """Those of the points; None where that takes much memory."""
        small = self.weights.numel() <= _MOST_SLOPES
        return self.cage.slopes(self.points) if small else None

    def turned(self, vertices: Tensor, *, quick: bool = False) -> Tensor | None:
        """Derivatives (N, 3, 3) of the ways of the points to where `moved` takes them.

        None where they have to be computed anew for every shape; `quick`: or for the first one.
        """
        slopes = None if quick and "_slopes" not in vars(self) else self._slopes
        if slopes is None:
            return None
        ways = self._moves(vertices).T @ slopes.flatten(1)
        return ways.unflatten(1, (-1, 3)).transpose(0, 1).double()

    def is_of(self, points: Tensor) -> bool:
        """Whether these are its points (N, 3), to the last bit."""
        same = points.shape == self.points.shape
        return same and torch.equal(points.detach().cpu().double(), self.points.cpu().double())

    def moved(self, vertices: Tensor) -> Tensor:
        """Return where the points (N, 3) go when the cage takes the shape `vertices` (V, 3)."""
        _check_count(self.cage, vertices)
        ways = self._moves(vertices).T @ self.weights.T
        return self.points + ways.T.to(self.points)

    def _moves(self, vertices: Tensor) -> Tensor:
        """What is carried, (V, 3) float32: a cage that stays moves no point in the last bit."""
        return (vertices.detach().cpu().double() - self.cage.vertices).float()


class CageDeform(Deformation):
    """Space that goes along with a cage by mean value coordinates.

    Smooth inside and outside, with a kink across the cage itself. Gradients with respect to
    points are those of `jacobian`; there are no second ones.
    """

    def __init__(
        self,
        cage: Cage,
        vertices: Tensor,
        binding: CageBinding | None = None,
        *,
        quick: bool = False,
    ) -> None:
        """Prepare the map.

        Args:
            cage: at rest.
            vertices: (V, 3) the new places of its vertices, world units.
            binding: of the same cage; its points and Jacobians are found by it, in milliseconds
                and to single precision of their way, all others by the formula.
            quick: Jacobians at the points of the binding are fitted to where they go, in one step.

        Raises:
            InputError: another number of vertices, NaN or infinity.
        """
        _check_count(cage, vertices)
        self.cage, self.binding, self._quick = cage, binding, quick
        self.vertices = frozen_tensor("deformed cage", vertices, tuple(cage.vertices.shape))
        self._moves: FloatArray = (self.vertices - cage.vertices).numpy()
        self._known: tuple[Tensor, Tensor, Tensor] | None = None

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units."""
        check_points(points)
        moved: Tensor = _Carry.apply(points.reshape(-1, 3), self)  # pyright: ignore
        return moved.reshape(points.shape)

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3) by formula, without gradient; of the binding in single precision.

        On the cage itself, where the map has a kink, that of a place beside.
        """
        check_points(points)
        flat = points.detach().reshape(-1, 3)
        bound = self.binding if self.binding is not None and self.binding.is_of(flat) else None
        eye = torch.eye(3, dtype=torch.float64)
        turn = None if bound is None else bound.turned(self.vertices, quick=self._quick)
        if turn is not None:
            return (eye + turn).to(points).reshape(*points.shape, 3)
        if bound is not None and self._quick:
            linear, _ = sites_of(flat).maps(self.displaced(flat), quick=True)
            return linear.to(points).reshape(*points.shape, 3)
        known = self._recall(flat)
        if known is None:
            known = self.cage.carry(flat, self._moves, slope=True)
            # Jacobians and places of the same points are asked for in turn, and they cost seconds.
            self._known = (flat.cpu().double(), *known)
        return (eye + known[1]).to(points).reshape(*points.shape, 3)

    def displaced(self, points: Tensor) -> Tensor:
        """Do the same as a call for points (N, 3) without gradient."""
        if self.binding is not None and self.binding.is_of(points):
            return self._moved.to(points)
        known = self._recall(points)
        way, _ = self.cage.carry(points, self._moves, slope=False) if known is None else known
        return (points.detach().double() + way.to(points.device)).to(points.dtype)

    @cached_property
    def _moved(self) -> Tensor:
        """Where the points of the binding go; frames are asked for next, and take it from here."""
        assert self.binding is not None
        return self.binding.moved(self.vertices)

    def _recall(self, points: Tensor) -> tuple[Tensor, Tensor] | None:
        """What the last Jacobians were computed with, if these are the same points."""
        if self._known is None or self._known[0].shape != points.shape:
            return None
        places, way, turn = self._known
        return (way, turn) if torch.equal(places, points.detach().cpu().double()) else None


class _Carry(torch.autograd.Function):
    """The compiled map for torch: the backward pass multiplies by the Jacobian."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, deform: CageDeform) -> Tensor:
        ctx.save_for_backward(points)
        ctx.deform = deform
        return deform.displaced(points)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:  # pyright: ignore
        (points,) = ctx.saved_tensors
        jacobian = ctx.deform.jacobian(points)
        return (grad.unsqueeze(-1) * jacobian).sum(dim=-2), None


def _check_faces(vertices: Tensor, faces: Tensor) -> None:
    """Raise InputError unless every edge belongs to two triangles that run it in both senses."""
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise InputError(f"cage: expected triangles (F, 3), got {tuple(faces.shape)}")
    if int(faces.min()) < 0 or int(faces.max()) >= len(vertices):
        raise InputError(
            f"cage: expected vertex numbers from 0 to {len(vertices) - 1} in its triangles, got "
            f"{int(faces.min())} to {int(faces.max())}"
        )
    # Files repeat vertices along seams of textures: one place is one vertex here.
    _, number = torch.unique(vertices, dim=0, return_inverse=True)
    merged = number[faces].numpy()
    merged = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]
    count = len(vertices)
    forth = merged * count + np.roll(merged, -1, axis=1)
    back = np.roll(merged, -1, axis=1) * count + merged
    lonely = int((~np.isin(forth.ravel(), back.ravel())).sum())
    if lonely:
        once = len(np.unique(forth)) == forth.size
        what = "open edges" if once else "edges whose triangles are turned different ways"
        raise InputError(
            "cage: expected a closed mesh, in which every edge belongs to two triangles turned the "
            f"same way, got {lonely} {what}; close its holes and let its normals be recalculated"
        )


def _check_count(cage: Cage, vertices: Tensor) -> None:
    if vertices.shape != cage.vertices.shape:
        raise InputError(
            f"cage: expected as many vertices after as before, {tuple(cage.vertices.shape)}, got "
            f"{tuple(vertices.shape)}"
        )

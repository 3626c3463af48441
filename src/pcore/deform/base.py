"""What a deformation is: a pure, differentiable, batched map R^3 -> R^3, and how maps combine."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pcore.deform.derivatives import gradients
from pcore.errors import InputError
from pcore.geometry.matrix_tuples import products, uprightnesses

# A share of `orientation`, which is 1 for rigid motions and does not depend on units.
SINGULAR = 1e-6


class Deformation(ABC):
    """A map R^3 -> R^3 in world units whose parameters are frozen.

    It acts on every point by itself: one point and a million points give the same answer, so
    the same map can carry points, surface points, ray origins and anchors. The result has the
    dtype and device of the input and can be differentiated with respect to it.
    """

    @abstractmethod
    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units, to their new places (..., 3)."""

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3) at points (..., 3): `J[..., i, j] = d out_i / d in_j`.

        This default differentiates the three output coordinates in turn: because every point
        moves by itself, the gradient of a sum over points is one row of all Jacobians. It
        costs about three backward passes; subclasses with a short formula override it. A map that
        autograd cannot follow, through NumPy for instance, is measured by central differences.
        """
        check_points(points)
        return gradients(self, points, measured=True)

    def folded(self, points: Tensor) -> Tensor:
        """Where space is flattened or turned inside out: bool (...,) at points (..., 3).

        True where det J is 0, nearly so, negative or not a number. Maps that can turn a
        part of space over while det J stays positive override it.
        """
        with torch.no_grad():
            return self.folded_given(points, self.jacobian(points))

    def folded_given(self, points: Tensor, jacobian: Tensor) -> Tensor:
        """As `folded`, by the Jacobians (..., 3, 3) at the points, which are known already."""
        # Written so that a NaN counts as folded.
        return ~(uprightness(jacobian) > SINGULAR)

    def mended(self, points: Tensor) -> Tensor:
        """Where `jacobian` answers with a substitute: bool (...,) at points (..., 3).

        Nowhere, except for maps that are known by where points went: see `PointMotion`.
        """
        return torch.zeros(points.shape[:-1], dtype=torch.bool, device=points.device)


@dataclass(frozen=True)
class Identity(Deformation):
    """The map that leaves everything where it is."""

    def __call__(self, points: Tensor) -> Tensor:
        """Return the points (..., 3) themselves."""
        check_points(points)
        return points

    def jacobian(self, points: Tensor) -> Tensor:
        """Return the unit matrix (..., 3, 3) at every point (..., 3)."""
        check_points(points)
        eye = torch.eye(3, dtype=points.dtype, device=points.device)
        return eye.expand(*points.shape, 3)


@dataclass(frozen=True, eq=False)
class Affine(Deformation):
    """x -> matrix x + offset.

    Attributes:
        matrix: (3, 3).
        offset: (3,) world units.
    """

    matrix: Tensor
    offset: Tensor

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", frozen_tensor("affine matrix", self.matrix, (3, 3)))
        object.__setattr__(self, "offset", frozen_tensor("affine offset", self.offset, (3,)))

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3)."""
        check_points(points)
        return apply_matrix(self.matrix.to(points), points) + self.offset.to(points)

    def jacobian(self, points: Tensor) -> Tensor:
        """Return the matrix at every point: (..., 3, 3)."""
        check_points(points)
        return self.matrix.to(points).expand(*points.shape, 3)

    def inverse(self) -> Affine:
        """Return the map that undoes this one.

        Raises:
            InputError: the matrix has no inverse.
        """
        if float(torch.linalg.det(self.matrix)) == 0.0:
            raise InputError("affine: expected an invertible matrix to invert, got a singular one")
        inverse = torch.linalg.inv(self.matrix)
        return Affine(inverse, -apply_matrix(inverse, self.offset))


class Compose(Deformation):
    """Deformations applied one after another: `Compose(first, second)(x) = second(first(x))`.

    Attributes:
        steps: the maps in the order in which they act.
    """

    def __init__(self, *steps: Deformation) -> None:
        self.steps: tuple[Deformation, ...] = steps

    def __repr__(self) -> str:
        return f"Compose({', '.join(repr(step) for step in self.steps)})"

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3) through all steps."""
        check_points(points)
        for step in self.steps:
            points = step(points)
        return points

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3) at points (..., 3) by the chain rule."""
        total = Identity().jacobian(points)
        for step in self.steps:
            total = matrix_product(step.jacobian(points), total)
            points = step(points)
        return total

    def folded(self, points: Tensor) -> Tensor:
        """Where any of the steps folds space (two folds do not undo each other)."""
        check_points(points)
        result = torch.zeros(points.shape[:-1], dtype=torch.bool, device=points.device)
        for step in self.steps:
            result = result | step.folded(points)
            points = step(points)
        return result

    def mended(self, points: Tensor) -> Tensor:
        """Where any of the steps answers with a substitute."""
        result = super().mended(points)
        for step in self.steps:
            result = result | step.mended(points)
            points = step(points)
        return result


def orientation(deformation: Deformation, points: Tensor) -> Tensor:
    """How far the map is from folding: (...,) at points (..., 3), without gradient.

    The determinant of the Jacobian divided by that of the scaling with the same Frobenius
    norm, so it is 1 for every rigid motion and uniform scaling, 0 where the map is singular and
    negative where it turns space inside out. It does not depend on units.
    """
    with torch.no_grad():
        return uprightness(deformation.jacobian(points))


def uprightness(jacobian: Tensor) -> Tensor:
    """Return `orientation` of Jacobians (..., 3, 3): (...,)."""
    if jacobian.dtype == torch.float64 and jacobian.device.type == "cpu":
        flat = jacobian.detach().reshape(-1, 3, 3).contiguous().numpy()
        return torch.from_numpy(uprightnesses(flat)).reshape(jacobian.shape[:-2])
    with torch.no_grad():
        # Closed form instead of torch.linalg.det, which factorises matrix by matrix.
        rows = jacobian.unbind(dim=-2)
        determinant = (rows[0] * torch.linalg.cross(rows[1], rows[2])).sum(dim=-1)
        scale = (jacobian.square().sum(dim=(-2, -1)) / 3.0).sqrt() ** 3
        tiny = torch.finfo(scale.dtype).tiny
        return torch.where(scale > tiny, determinant / scale.clamp_min(tiny), 0.0)


def apply_matrix(matrix: Tensor, vectors: Tensor) -> Tensor:
    """Matrix (3, 3) times vectors (..., 3).

    Written as sums of products because a matrix multiplication may run in half precision (autocast)
    or TF32 and depends on the batch size in the last bit; places in space must do neither.
    """
    x, y, z = vectors[..., 0:1], vectors[..., 1:2], vectors[..., 2:3]
    return x * matrix[:, 0] + y * matrix[:, 1] + z * matrix[:, 2]


def matrix_product(left: Tensor, right: Tensor) -> Tensor:
    """Product (..., 3, 3) of matrices that broadcast; in full precision as `apply_matrix` is.

    On the CPU in double precision, where no gradient is asked for, in one pass: the same bits in a
    twelfth of the time.
    """
    both = left, right
    plain = all(one.dtype == torch.float64 and one.device.type == "cpu" for one in both)
    if plain and not (torch.is_grad_enabled() and any(one.requires_grad for one in both)):
        # torch's own imports sympy at its first call, which takes half a second.
        shape = np.broadcast_shapes(left.shape, right.shape)
        rows = (one.detach().expand(shape).reshape(-1, 3, 3).contiguous().numpy() for one in both)
        return torch.from_numpy(products(*rows)).reshape(shape)
    return (
        left[..., :, 0:1] * right[..., 0:1, :]
        + left[..., :, 1:2] * right[..., 1:2, :]
        + left[..., :, 2:3] * right[..., 2:3, :]
    )


def check_points(points: Tensor) -> None:
    """Raise InputError unless points are floating-point and of shape (..., 3)."""
    if points.ndim < 1 or points.shape[-1] != 3 or not points.is_floating_point():
        raise InputError(
            "deformation: expected floating-point points of shape (..., 3), "
            f"got {tuple(points.shape)} of {points.dtype}"
        )


def frozen_tensor(name: str, value: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Return a float64 CPU copy of a parameter that nobody else can change in place.

    Raises:
        InputError: another shape than expected, NaN or infinity in it, or autograd follows it.
    """
    if torch.is_grad_enabled() and value.requires_grad:
        raise InputError(
            f"{name}: expected a fixed parameter, got one that asks for a gradient, which this "
            "deformation does not have; detach it, or write a Deformation of your own with the "
            "parameter in it (docs/tutorials/5-your-own-deformation.md)"
        )
    copy = value.detach().to(device="cpu", dtype=torch.float64, copy=True)
    if tuple(copy.shape) != shape:
        raise InputError(f"{name}: expected shape {shape}, got {tuple(copy.shape)}")
    if not bool(torch.isfinite(copy).all()):
        raise InputError(f"{name}: expected finite numbers, got {copy.tolist()}")
    return copy

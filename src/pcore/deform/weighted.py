"""Deformations that act in part: in a region, or everywhere but in one."""

from __future__ import annotations

import torch
from torch import Tensor

from pcore.deform.base import SINGULAR, Deformation, Identity, check_points, matrix_product
from pcore.deform.base import orientation as orientation_of
from pcore.deform.region import Region


class Weighted(Deformation):
    """x -> x + w(x) (D(x) - x) with the weight w of a region, minus that of a frozen one.

    Attributes:
        inner: D.
        region: where it acts; None is everywhere.
        frozen: where it does not act whatever `region` says; None is nowhere.
        amount: factor on the weight: 0 is the identity, 1 the whole of D.
    """

    def __init__(
        self,
        inner: Deformation,
        region: Region | None = None,
        frozen: Region | None = None,
        *,
        amount: float = 1.0,
    ) -> None:
        self.inner, self.region, self.frozen, self.amount = inner, region, frozen, amount
        self._last: tuple[tuple[object, ...], Tensor, Tensor] | None = None

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units; where the weight is 0 they stay exactly."""
        check_points(points)
        return blend(points, self._whole(points), self.weight(points))

    def _whole(self, points: Tensor) -> Tensor:
        """D(x); who was told where points go asks for it again with the Jacobians there."""
        kind = points.dtype, points.device, torch.is_grad_enabled()
        if self._last is not None and self._last[0] == kind and not points.requires_grad:
            _, places, moved = self._last
            if torch.equal(places, points):
                return moved
        moved = self.inner(points)
        if not moved.requires_grad:
            self._last = kind, points.detach().clone(), moved
        return moved

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3): I + w (J - I) + (D(x) - x) grad(w)^T."""
        check_points(points)
        eye = Identity().jacobian(points)
        weight = self.weight(points)[..., None, None]
        way = (self._whole(points) - points).unsqueeze(-1)
        turned = eye + weight * (self.inner.jacobian(points) - eye)
        return turned + way * self._gradient(points).unsqueeze(-2)

    def folded_given(self, points: Tensor, jacobian: Tensor) -> Tensor:
        """Where space is flattened or turned inside out, bool (...,)."""
        result, whole = super().folded_given(points, jacobian), self.weight(points) == 1
        if bool(whole.any()):
            result[whole] |= self.inner.folded(points[whole])
        return result

    def mended(self, points: Tensor) -> Tensor:
        """Where it acts and its inner map answers with a substitute."""
        return self.inner.mended(points) & (self.weight(points) != 0)

    def weight(self, points: Tensor) -> Tensor:
        """Share (...,) of the way to D(x) that points (..., 3) go."""
        weight = torch.full_like(points[..., 0], self.amount)
        if self.region is not None:
            weight = weight * self.region.weight(points)
        return weight if self.frozen is None else weight * (1.0 - self.frozen.weight(points))

    def _gradient(self, points: Tensor) -> Tensor:
        """Product rule over the two weights: (..., 3)."""
        slope = torch.zeros_like(points)
        if self.region is not None:
            slope = self.amount * self.region.gradient(points)
        if self.frozen is None:
            return slope
        slope = slope * (1.0 - self.frozen.weight(points)).unsqueeze(-1)
        inside = 1.0 if self.region is None else self.region.weight(points).unsqueeze(-1)
        return slope - self.amount * inside * self.frozen.gradient(points)


class Held(Deformation):
    """Steps one after another with a region that never moves.

    Each step moves a point by 1 - h of the way, h being the weight of the region at the place where
    the point was before the first step: what is frozen stays frozen wherever the steps would take
    it, and nothing is held up by passing through the region.

    Attributes:
        steps: the maps in the order in which they act.
        hold: the region that stays, in the space before the first step.
    """

    def __init__(self, steps: tuple[Deformation, ...], hold: Region) -> None:
        self.steps, self.hold = steps, hold

    def __call__(self, points: Tensor) -> Tensor:
        """Map points (..., 3), world units; where `hold` is 1 they stay exactly."""
        check_points(points)
        free = 1.0 - self.hold.weight(points)
        for step in self.steps:
            points = blend(points, step(points), free)
        return points

    def jacobian(self, points: Tensor) -> Tensor:
        """Jacobians (..., 3, 3): step by step J + f (J_step - I) J + (step(y) - y) grad(f)^T."""
        check_points(points)
        free = 1.0 - self.hold.weight(points)
        total, place = Identity().jacobian(points), points
        for step in self.steps:
            total = self.further(step, step.jacobian(place), points, place, total)
            place = blend(place, step(place), free)
        return total

    def further(
        self, step: Deformation, jacobian: Tensor, points: Tensor, place: Tensor, total: Tensor
    ) -> Tensor:
        """Jacobians (..., 3, 3) after one more step, from those before it.

        Args:
            step: the next one.
            jacobian: (..., 3, 3) of the step at `place`.
            points: (..., 3) before the first step.
            place: (..., 3) where they are before this one.
            total: (..., 3, 3) Jacobians so far, at `points`.
        """
        free = 1.0 - self.hold.weight(points)
        slope = -self.hold.gradient(points).unsqueeze(-2)
        turned = free[..., None, None] * (jacobian - Identity().jacobian(points))
        way = (step(place) - place).unsqueeze(-1)
        return total + matrix_product(turned, total) + way * slope

    def folded(self, points: Tensor) -> Tensor:
        """Where any beginning of the sequence folds space (two folds do not undo each other)."""
        check_points(points)
        free = 1.0 - self.hold.weight(points)
        result = torch.zeros_like(free, dtype=torch.bool)
        place = points
        for number, step in enumerate(self.steps, start=1):
            beginning = Held(self.steps[:number], self.hold)
            result = result | ~(orientation_of(beginning, points) > SINGULAR)
            result = result | (step.folded(place) & (free == 1))
            place = blend(place, step(place), free)
        return result

    def mended(self, points: Tensor) -> Tensor:
        """Where a step answers with a substitute and nothing is held."""
        free = 1.0 - self.hold.weight(points)
        result, place = super().mended(points), points
        for step in self.steps:
            result = result | (step.mended(place) & (free != 0))
            place = blend(place, step(place), free)
        return result


def blend(start: Tensor, end: Tensor, weight: Tensor) -> Tensor:
    """Go from points (..., 3) a share (...,) of the way; shares of 0 and 1 are exact."""
    share = weight.unsqueeze(-1)
    part = start + share * (end - start)
    return torch.where(share == 1, end, torch.where(share == 0, start, part))

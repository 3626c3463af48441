"""Derivatives of maps that take every point by itself: by autograd, or measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

_STEP = 1e-5
"""Of central differences, as a share of the object: its square and a rounding over it are small."""
_SINGLE_STEP = 3e-3
"""The same of maps that answer in single precision."""


def gradients(
    function: Callable[[Tensor], Tensor], points: Tensor, *, measured: bool = False
) -> Tensor:
    """Derivatives (..., C, 3) of a function (..., 3) -> (..., C) that takes every point by itself.

    Row by row by automatic differentiation: because every point counts for itself, the gradient of
    a sum over points holds one row for all of them. Differentiable in the points and in parameters
    of the function, where autograd follows those. Rows that do not depend on the points, as far as
    autograd sees, are 0; `measured` ones are found by central differences.
    """
    enabled = torch.is_grad_enabled()
    keep_graph = enabled and points.requires_grad
    with torch.inference_mode(mode=False), torch.enable_grad():
        inputs = points if keep_graph else points.detach().clone().requires_grad_()
        try:
            outputs = function(inputs)
        except RuntimeError as error:  # NumPy takes no tensor that autograd follows.
            if not measured or "grad" not in str(error):
                raise
            outputs = points.detach()
        keep_graph = keep_graph or (enabled and _has_parameters(outputs, inputs))
        rows: list[Tensor | None] = [
            torch.autograd.grad(
                column.sum(),
                inputs,
                retain_graph=True,
                create_graph=keep_graph,
                allow_unused=True,
            )[0]
            for column in (outputs.unbind(dim=-1) if outputs.requires_grad else ())
        ]
    if measured and (not rows or any(map(_unseen, rows))):
        found = _differences(function, points)
        rows = [
            found[..., number, :] if _unseen(row) else row
            for number, row in enumerate(rows or [None] * found.shape[-2])
        ]
    elif not rows:
        return outputs.new_zeros(*outputs.shape, 3)
    return torch.stack([torch.zeros_like(points) if row is None else row for row in rows], dim=-2)


def _unseen(row: Tensor | None) -> bool:
    """Whether a row may be of a coordinate that autograd does not see; a constant is 0 as well."""
    return row is None or not (row.requires_grad or bool(row.any()))


def _differences(function: Callable[[Tensor], Tensor], points: Tensor) -> Tensor:
    """As `gradients`, by central differences in double precision; of a constant exactly 0.

    Of maps that answer in single precision they hold three digits near the origin.
    """
    places = points.detach().double()
    single = function(places).dtype != places.dtype
    size = _usual_size(places.reshape(-1, 3))
    step = (_SINGLE_STEP if single else _STEP) * size
    columns = [
        (function(places + one).double() - function(places - one).double()) / (2 * step)
        for one in step * torch.eye(3, dtype=places.dtype, device=places.device)
    ]
    return torch.stack(columns, dim=-1).to(points)


def _usual_size(places: Tensor) -> float:
    """What is long beside points (N, 3): no stray or broken one has a say."""
    known = places[places.isfinite().all(dim=-1)]
    if not len(known):
        return 1.0
    apart = (known - known.median(dim=0).values).abs().amax(dim=-1)
    # A single point has no extent; how far out it is says what is short there.
    return 4 * float(apart.median()) or float(known.abs().max()) or 1.0


def _has_parameters(outputs: Tensor, inputs: Tensor) -> bool:
    """Whether autograd follows other tensors to the outputs than the inputs."""
    waiting, seen = [outputs.grad_fn], set[Any]()
    while waiting:
        node = waiting.pop()
        if node is None or node in seen:
            continue
        seen.add(node)
        leaf = getattr(node, "variable", None)
        if leaf is not None and leaf is not inputs:
            return True
        waiting += [one for one, _ in node.next_functions]
    return False

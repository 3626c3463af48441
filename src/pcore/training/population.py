"""Which points go, and where new ones come."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn

from pcore.errors import InputError

_NEIGHBOURS_OF_SPREAD = 10
_PARENTS = 3


def replace_rows(
    optimizer: torch.optim.Optimizer, parameter: nn.Parameter, keep: Tensor, new: Tensor
) -> nn.Parameter:
    """Keep some rows of a parameter and append others; the kept rows keep Adam's moments.

    Args:
        optimizer: holds the parameter; its state and groups are updated in place.
        parameter: (N, ...).
        keep: (N,) bool.
        new: (A, ...) rows to append, with zero moments.

    Returns:
        The parameter that took the old one's place, (K + A, ...).
    """
    replaced = nn.Parameter(torch.cat([parameter.detach()[keep], new]))
    state = optimizer.state.pop(parameter, {})
    for name, value in state.items():
        if torch.is_tensor(value) and value.shape == parameter.shape:
            state[name] = torch.cat([value[keep], torch.zeros_like(new)])
    if state:
        optimizer.state[replaced] = state
    for group in optimizer.param_groups:
        group["params"] = [replaced if p is parameter else p for p in group["params"]]
    return replaced


def growth_sites(positions: Tensor, count: int) -> Tensor:
    """Indices (count,) of the points whose neighbour distances differ most (original's rule)."""
    if len(positions) <= _NEIGHBOURS_OF_SPREAD:
        raise InputError(
            f"growing: expected more than {_NEIGHBOURS_OF_SPREAD} points, got {len(positions)}"
        )
    array = positions.detach().cpu().numpy()
    distance, _ = KDTree(array).query(array, k=_NEIGHBOURS_OF_SPREAD + 1)
    spread = torch.from_numpy(distance[:, 1:].std(axis=1))
    order = torch.argsort(spread, descending=True, stable=True)
    return order[torch.arange(count) % len(order)].to(positions.device)


def growth_mixture(
    positions: Tensor, sites: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Parents and weights of new points: random convex combinations of the nearest neighbours.

    Args:
        positions: (N, 3).
        sites: (A,) where to grow.
        generator: draws the weights.

    Returns:
        parents (A, 3) indices and weights (A, 3) that sum to one.
    """
    array = positions.detach().cpu().numpy()
    _, nearest = KDTree(array).query(array[sites.cpu().numpy()], k=_PARENTS + 1)
    parents = torch.from_numpy(np.asarray(nearest)[:, 1:]).to(positions.device)
    weights = torch.rand(parents.shape, generator=generator).to(positions)
    return parents, weights / weights.sum(dim=-1, keepdim=True)

"""As-rigid-as-possible posing of anchors (Sorkine and Alexa 2007) over the anchor graph.

Minimises sum over links w_ij (|a'_i - a'_j - R_i (a_i - a_j)|^2 + |... R_j ...|^2) with the dragged
anchors held where they are put: rotations and places are solved for in turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu
from torch import Tensor

from pcore.deform.skinning import AnchorPose
from pcore.editing.anchors import AnchorGraph
from pcore.errors import EditError
from pcore.geometry.rotation import nearest_rotation, procrustes

FloatArray = NDArray[np.float64]
_ROUNDS = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class Handle:
    """Where one anchor is put.

    Attributes:
        place: (3,) world units.
        rotation: (3, 3) how what it carries is turned; None lets the neighbours decide.
    """

    place: Tensor
    rotation: Tensor | None = None


def drag(graph: AnchorGraph, handles: Mapping[int, Handle], *, reach: float) -> AnchorPose:
    """Pose all anchors after some of them were dragged.

    Args:
        graph: the anchors.
        handles: anchor index -> where it goes.
        reach: path length from the nearest handle, world units, beyond which anchors stay at
            rest; infinity lets everything follow.

    Raises:
        EditError: as `Dragger`.
    """
    return Dragger(graph, tuple(handles), reach=reach).pose(handles)


class Dragger:
    """Poses anchors for one set of handles: its linear system is factorised once."""

    def __init__(self, graph: AnchorGraph, held: tuple[int, ...], *, reach: float) -> None:
        """Prepare a drag.

        Args:
            graph: the anchors.
            held: indices of the anchors that will be dragged, at least one.
            reach: see `drag`.

        Raises:
            EditError: no handle, an anchor that does not exist, or a reach that is not positive.
        """
        count = len(graph.rest)
        unknown = [index for index in held if not 0 <= index < count]
        if not held or unknown:
            raise EditError(
                f"anchors: expected at least one handle with an anchor from 0 to {count - 1}, got "
                f"{', '.join(map(str, unknown)) if unknown else 'none'}"
            )
        if not reach > 0:
            raise EditError(f"anchors: expected a reach above 0, got {reach}")
        self._graph, self._held = graph, held
        near = graph.between[:, list(held)].amin(dim=1).numpy() <= reach
        self._resting: NDArray[np.bool_] = ~near
        fixed = self._resting.copy()
        fixed[list(held)] = True
        self._system = _System(graph, np.flatnonzero(~fixed), np.flatnonzero(fixed))

    def pose(self, handles: Mapping[int, Handle]) -> AnchorPose:
        """Pose all anchors for new places of the same handles.

        Raises:
            EditError: other handles than announced, or places that are not finite.
        """
        if set(handles) != set(self._held):
            raise EditError(
                f"anchors: expected places of the handles {sorted(self._held)}, "
                f"got {sorted(handles)}"
            )
        rest = self._graph.rest.double()
        places, turns = rest.clone(), torch.eye(3, dtype=torch.float64).repeat(len(rest), 1, 1)
        decided = torch.from_numpy(self._resting.copy())
        for index, handle in handles.items():
            if not bool(torch.isfinite(handle.place).all()):
                raise EditError(
                    f"anchors: expected a finite place of anchor {index}, got "
                    f"{handle.place.tolist()}"
                )
            places[index] = handle.place.double()
            decided[index] = handle.rotation is not None
            if handle.rotation is not None:
                turns[index] = handle.rotation.double()
        if any(handle.rotation is not None for handle in handles.values()):
            turns = self._system.spread(turns)
        turning = torch.nonzero(~decided).squeeze(1)
        for _ in range(_ROUNDS):
            places = self._system.places(places, turns)
            turns = self._system.turns(places, turns, turning)
        rest = self._graph.rest
        # Places of anchors at rest are copied, not solved for: they move by exactly nothing.
        still = torch.from_numpy(self._resting)[:, None]
        return AnchorPose(
            rest=rest,
            moved=torch.where(still, rest, places.to(rest)),
            rotations=turns.to(rest),
        )


@dataclass(eq=False)
class _System:
    """The two half steps, with what does not change between them."""

    graph: AnchorGraph
    free: NDArray[np.int64]
    fixed: NDArray[np.int64]
    _solver: Any = field(init=False, default=None)

    def __post_init__(self) -> None:
        index, weights = self.graph.rows
        rest = self.graph.rest.double()
        self._index, self._rows = index, torch.from_numpy(self.free)
        self._offsets, self._weights = rest.unsqueeze(1) - rest[index], weights.double()
        count = len(rest)
        links, w = self.graph.links.numpy(), self.graph.weights.double().numpy()
        i, j = links[:, 0], links[:, 1]
        data = np.concatenate([-w, -w, w, w])
        where = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
        laplacian = csc_array(coo_array((data, where), shape=(count, count)))
        rows = laplacian[self.free]
        self._coupling = rows[:, self.fixed]
        if len(self.free):
            self._solver = splu(csc_array(rows[:, self.free]))

    def places(self, places: Tensor, turns: Tensor) -> Tensor:
        """Places that fit the rotations best; fixed ones stay."""
        if self._solver is None:
            return places
        free = self._rows
        both = 0.5 * (turns[free].unsqueeze(1) + turns[self._index[free]])
        pulls = both @ (self._weights.unsqueeze(-1) * self._offsets)[free].unsqueeze(-1)
        known: FloatArray = places.numpy()[self.fixed]
        wanted: FloatArray = pulls.sum(dim=1).squeeze(-1).numpy()
        result = places.clone()
        result[free] = torch.from_numpy(self._solver.solve(wanted - self._coupling @ known))
        return result

    def spread(self, turns: Tensor) -> Tensor:
        """Begin with rotations that vary smoothly between the fixed anchors.

        The rounds hand a turn on by one link each; without this a turned handle would not carry
        along what lies many links away.
        """
        if self._solver is None:
            return turns
        known: FloatArray = turns.flatten(1).numpy()[self.fixed]
        smooth = torch.from_numpy(self._solver.solve(-(self._coupling @ known)))
        result = turns.clone()
        result[self._rows] = nearest_rotation(smooth.unflatten(1, (3, 3)))
        return result

    def turns(self, places: Tensor, turns: Tensor, turning: Tensor) -> Tensor:
        """Rotations of some anchors that fit the places best; the others stay."""
        now = places[turning].unsqueeze(1) - places[self._index[turning]]
        result = turns.clone()
        result[turning] = procrustes(self._offsets[turning], now, self._weights[turning])
        return result

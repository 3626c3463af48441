"""The edit "cage": space goes along with a closed mesh around the object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from torch import Tensor

from pcore.deform.base import Deformation
from pcore.deform.cage import Cage, CageBinding, CageDeform
from pcore.deform.weighted import Weighted
from pcore.editing.contents import content_of, from_content
from pcore.editing.regions import Setting
from pcore.editing.shapes import MeshPair, reached
from pcore.errors import EditError
from pcore.geometry.point_cloud import size_of

LARGE = 10.0
"""How many times larger than the object a cage is, seldom by intent: it hardly acts then."""


class CageEdit(MeshPair):
    """Space goes along with a closed mesh around the object."""

    advice: ClassVar[str] = 'move the vertices of the cage less, or lower "amount"'

    type: Literal["cage"] = "cage"

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self.place(Setting(points=points, rest=points))

    def place(self, setting: Setting) -> Deformation:
        """See `Edit.place`; the same cage and points are bound once, whatever shape it takes."""
        before, after = self.meshes()
        rest = content_of(before.vertices), content_of(before.faces), content_of(setting.points)
        whole = _deform(*rest, content_of(after.vertices), setting.quick)
        return whole if self.amount == 1.0 else Weighted(whole, amount=self.amount)

    def notes(self, setting: Setting, step: Deformation) -> tuple[str, ...]:
        """See `Edit.notes`: a cage acts on what it does not hold, but that is seldom meant."""
        before, _ = self.meshes()
        points = setting.points
        known = _bound(content_of(before.vertices), content_of(before.faces), content_of(points))
        acted = reached(step, points)
        total, held = int(acted.sum()), int((known.inside & acted).sum())
        if total and not held:
            raise EditError(
                f"{self.before}: expected a cage around the object, got one that holds none of the "
                f"{total} points it is to move: it goes from {_corners(before.vertices)}, they "
                f'from {_corners(points[acted])}; check its units and the axis that is "up"'
            )
        said = [*super().notes(setting, step)]
        size, whole = size_of(before.vertices), size_of(points)
        if size > LARGE * whole:
            said.append(
                f"the cage is {size:.3g} large and the object {whole:.3g}, world units; it should "
                "stand close around it: are both in the same units?"
            )
        if held < total:
            said.append(
                f"{total - held} of {total} points lie outside the cage, where it acts ever more "
                "weakly; make it larger, or give the edit a region"
            )
        return tuple(said)


@dataclass(frozen=True, kw_only=True, eq=False)
class _BoundCage:
    binding: CageBinding
    inside: Tensor


# The weights of 30,000 points in a cage of 500 vertices take 60 MB, so few are kept.
@lru_cache(maxsize=2)
def _bound(vertices: bytes, faces: bytes, points: bytes) -> _BoundCage:
    cage = Cage(vertices=from_content(vertices), faces=from_content(faces, np.int64))
    places = from_content(points)
    return _BoundCage(binding=cage.bind(places), inside=cage.holds(places))


@lru_cache(maxsize=2)
def _deform(vertices: bytes, faces: bytes, points: bytes, after: bytes, quick: bool) -> CageDeform:
    """Keeps its Jacobians too: they serve every amount of the same shape."""
    binding = _bound(vertices, faces, points).binding
    return CageDeform(binding.cage, from_content(after), binding, quick=quick)


def _corners(places: Tensor) -> str:
    lower, upper = places.amin(dim=0).tolist(), places.amax(dim=0).tolist()
    return " to ".join(f"({', '.join(f'{x:.3g}' for x in corner)})" for corner in (lower, upper))

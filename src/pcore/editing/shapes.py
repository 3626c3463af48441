"""Edits that come from files: meshes in two shapes, displaced points."""

from __future__ import annotations

from abc import abstractmethod
from functools import lru_cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from pcore.data.meshes import MeshFile, read_mesh
from pcore.data.points import read_point_file
from pcore.deform.base import Deformation
from pcore.deform.proxy import BoundMesh, middle_distance
from pcore.deform.scattered import PointMotion
from pcore.deform.weighted import Weighted
from pcore.editing.contents import content_of, from_content
from pcore.editing.edits import Edit
from pcore.editing.fields import Amount, Between, Positive, StoredFile, StoredPlaces
from pcore.editing.regions import Setting
from pcore.errors import EditError
from pcore.geometry.neighbours import nearest
from pcore.geometry.point_cloud import size_of

SAME = 1e-4
NEAR = 0.02
"""How far a point may be from the one it is matched with, as a share of the object's size: by id,
where both should be the same, and by position."""

UNLIKE = 5.0
"""How many times larger or smaller the second shape is than the first, seldom by intent."""
ELSEWHERE = 0.2
"""Median distance of the points from a mesh, as a share of the object's size, that is no mistake of
shape but of place."""
BESIDE = 0.05
"""The same from which on a mesh does not look like the object's. Proxies of 30 vertices and
convex hulls lie nearer."""

_MESH = "the path of a mesh (.ply, .obj or .glb)"
_POINTS = "the path of a file of points (.npy or .ply)"


class EasedEdit(Edit):
    """What edits share that know one end of a motion: x + amount (D(x) - x) of the whole D."""

    advice: ClassVar[str] = 'turn the object instead of mirroring it, or lower "amount"'

    amount: Amount = 1.0

    @abstractmethod
    def shapes(self) -> tuple[Tensor, Tensor]:
        """Places (V, 3) of the same things before and after, world units; errors as `bind`."""

    def notes(self, setting: Setting, step: Deformation) -> tuple[str, ...]:
        """See `Edit.notes`: shapes of very different sizes are seldom in the same units."""
        first, second = (size_of(places) for places in self.shapes())
        if max(first, second) <= UNLIKE * min(first, second):
            return ()
        return (
            f'"before" is {first:.3g} large and "after" {second:.3g}, world units; are both files '
            "in the same units?",
        )


class MeshPair(EasedEdit):
    """What edits by a mesh share: the same mesh in two shapes."""

    before: Annotated[StoredFile, Field(description=_MESH)]
    after: Annotated[StoredPlaces, Field(description=f"{_MESH}, or a list of its vertices")]
    up: Annotated[Literal["y", "z"], Field(description='"y" or "z"')] = "z"

    def meshes(self) -> tuple[MeshFile, MeshFile]:
        """Read both shapes; vertices that are given as they are stand in world units, z up.

        Raises:
            InputError: a file cannot be read.
            EditError: they are not the same mesh.
        """
        before = _mesh(self.before, self.up)
        if isinstance(self.after, Between):
            return before, self._between(before, self.after)
        if isinstance(self.after, str):
            name, after = self.after, _mesh(self.after, self.up)
        else:
            vertices = torch.tensor(self.after, dtype=torch.float64).reshape(-1, 3)
            name, after = 'key "after"', MeshFile(vertices=vertices, faces=before.faces)
        self._check_same(before, name, after)
        return before, after

    def _between(self, before: MeshFile, both: Between) -> MeshFile:
        ends = [_mesh(file, self.up) for file in (both.first, both.second)]
        for name, one in zip((both.first, both.second), ends, strict=True):
            self._check_same(before, name, one)
        vertices = torch.lerp(ends[0].vertices, ends[1].vertices, both.share)
        return MeshFile(vertices=vertices, faces=before.faces)

    def _check_same(self, before: MeshFile, name: str, after: MeshFile) -> None:
        if len(before.vertices) != len(after.vertices):
            raise EditError(
                f"{name}: expected the {len(before.vertices)} vertices of {self.before}, got "
                f"{len(after.vertices)}; export both from the same mesh, without changing its "
                "topology"
            )
        if not torch.equal(before.faces, after.faces):
            raise EditError(
                f"{name}: expected the same faces as in {self.before}, got others, so its "
                "vertices may be in another order; export both in the same way"
            )

    def shapes(self) -> tuple[Tensor, Tensor]:
        """See `EasedEdit.shapes`."""
        before, after = self.meshes()
        return before.vertices, after.vertices


class MeshEdit(MeshPair):
    """The points follow a mesh that lies at them."""

    type: Literal["mesh"] = "mesh"

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self.place(Setting(points=points, rest=points))

    def place(self, setting: Setting) -> Deformation:
        """See `Edit.place`; the same mesh and points are bound once, whatever shape it takes."""
        before, after = self.meshes()
        rest = content_of(before.vertices), content_of(before.faces), content_of(setting.points)
        return _bound(*rest).to(after.vertices, quick=setting.quick).eased(self.amount)

    def notes(self, setting: Setting, step: Deformation) -> tuple[str, ...]:
        """See `Edit.notes`: a mesh that does not look like the object is seldom meant."""
        said, points = super().notes(setting, step), setting.points[reached(step, setting.points)]
        size = size_of(setting.points)
        away = _away(_mesh(self.before, self.up), points)
        if away <= BESIDE * size:
            return said
        other = "z" if self.up == "y" else "y"
        turned = _away(_mesh(self.before, other), points)
        if turned < 0.5 * away:
            raise EditError(
                f'{self.before}: expected a mesh that lies at the points, got "up": "{self.up}", '
                f"with which half of them are more than {away:.3g} away from it, and {turned:.3g} "
                f'with the other; give "up": "{other}"'
            )
        if away > ELSEWHERE * size:
            raise EditError(
                f"{self.before}: expected a mesh that lies at the points, got one that half of "
                f"those it is to move are more than {away:.3g} world units away from, the object "
                f'being {size:.3g} large; check its units and the axis that is "up"'
            )
        return (
            *said,
            f"half of the points are more than {away:.3g} world units away from the mesh, the "
            f"object being {size:.3g} large; is it the mesh of this object, in its units and its "
            "place?",
        )


class DisplacementEdit(EasedEdit):
    """The points go where a file says, and space between them along with them."""

    type: Literal["displacement"] = "displacement"
    before: Annotated[StoredFile, Field(description=_POINTS)]
    after: Annotated[StoredFile | Between, Field(description=_POINTS)]
    match: Annotated[Literal["id", "position"], Field(description='"id" or "position"')] = "id"
    tolerance: Positive | None = Field(default=None, description="a length above 0, world units")

    def shapes(self) -> tuple[Tensor, Tensor]:
        """See `EasedEdit.shapes`."""
        before, after = _points(self.before), self.after
        if isinstance(after, str):
            return before, self._places(before, after)
        first, second = self._places(before, after.first), self._places(before, after.second)
        return before, torch.lerp(first, second, after.share)

    def _places(self, before: Tensor, file: str) -> Tensor:
        after = _points(file)
        if len(before) != len(after):
            raise EditError(
                f"{file}: expected a new place for each of the {len(before)} points of "
                f"{self.before}, got {len(after)}"
            )
        return after

    def bind(self, points: Tensor) -> Deformation:
        """See `Edit.bind`."""
        return self.place(Setting(points=points, rest=points))

    def place(self, setting: Setting) -> Deformation:
        """See `Edit.place`."""
        (before, after), points = self.shapes(), setting.points
        if self.match == "id":
            self._check_ids(points, before)
        else:
            self._check_places(points, before)
            # The local maps at the points are fitted to the points: those of others tear elsewhere.
            after = PointMotion(before, after)(points)
        return PointMotion(points, after, quick=setting.quick).eased(self.amount)

    def _check_ids(self, points: Tensor, before: Tensor) -> None:
        if len(before) != len(points):
            raise EditError(
                f"{self.before}: expected the {len(points)} points that arrive at this edit, got "
                f'{len(before)}; a file of another model needs "match": "position"'
            )
        limit = SAME * size_of(points) if self.tolerance is None else self.tolerance
        away = (points - before).norm(dim=-1)
        if bool((away > limit).any()):
            first = int((away > limit).nonzero()[0])
            shuffled = bool((_distance(points, before)[0] <= limit).all())
            why = "the same points in another order" if shuffled else "other points"
            raise EditError(
                f"{self.before}: expected point by point the places of the points that arrive at "
                f"this edit, got {why}: {int((away > limit).sum())} are more than {limit:.3g} "
                f'away, the first is number {first}; use "match": "position"'
            )

    def _check_places(self, points: Tensor, before: Tensor) -> None:
        limit = NEAR * size_of(points) if self.tolerance is None else self.tolerance
        away, _ = _distance(points, before)
        lost = away > limit
        if bool(lost.any()):
            raise EditError(
                f"{self.before}: expected a point within {limit:.3g} of every point that arrives "
                f"at this edit, got none for {int(lost.sum())} of {len(points)}, the farthest is "
                f'{float(away.max()):.3g} away; give a larger "tolerance" if that is meant'
            )


def _mesh(path: str, up: Literal["y", "z"]) -> MeshFile:
    """Read a mesh; one whose file holds what it held is not parsed again."""
    try:
        return _known_mesh(path, up, Path(path).read_bytes())
    except OSError:
        return read_mesh(path, up=up)


@lru_cache(maxsize=4)
def _known_mesh(path: str, up: Literal["y", "z"], content: bytes) -> MeshFile:
    del content  # Part of the key: a file that was written anew is read anew.
    return read_mesh(path, up=up)


def _points(path: str) -> Tensor:
    """Places (N, 3) float64 of a file of points, read anew when it holds something else."""
    try:
        return _known_points(path, Path(path).read_bytes())
    except OSError:
        return read_point_file(path).positions.double()


@lru_cache(maxsize=4)
def _known_points(path: str, content: bytes) -> Tensor:
    del content
    return read_point_file(path).positions.double()


@lru_cache(maxsize=2)
def _bound(vertices: bytes, faces: bytes, points: bytes) -> BoundMesh:
    return BoundMesh.of(from_content(points), from_content(vertices), from_content(faces, np.int64))


def reached(step: Deformation, points: Tensor) -> Tensor:
    """Which of the points (N, 3) an edit with its region acts on: bool (N,)."""
    if isinstance(step, Weighted):
        return step.weight(points) != 0
    return torch.ones(len(points), dtype=torch.bool)


def _away(mesh: MeshFile, points: Tensor) -> float:
    """Median distance of points (N, 3) from a mesh; 0 without any."""
    if not len(points):
        return 0.0
    return _middle(content_of(mesh.vertices), content_of(mesh.faces), content_of(points))


@lru_cache(maxsize=4)
def _middle(vertices: bytes, faces: bytes, points: bytes) -> float:
    """As `_away`; of a mesh that is dragged it is found once."""
    return middle_distance(
        from_content(points), from_content(vertices), from_content(faces, np.int64)
    )


def _distance(points: Tensor, others: Tensor) -> tuple[Tensor, Tensor]:
    """Distance (N,) from points to the nearest of others, and which it is."""
    index, distance = nearest(others, points, 1)
    return distance[:, 0], index[:, 0]

"""A voxel radiance field that a cage warps, as a method."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from pcore.evaluation.runner import Tells
from pcore.evaluation.states import CANONICAL, State
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.rivals.voxels import VoxelField, Warp, cage_warp


@dataclass(frozen=True, kw_only=True, eq=False)
class VoxelMethod:
    """A field and the cage around it, whose vertices go where a state takes them.

    Attributes:
        name: for tables.
        field: as it was trained.
        cage: vertices (V, 3) and faces (F, 3) at rest.
    """

    name: str
    field: VoxelField
    cage: tuple[Tensor, Tensor]
    tells: Tells = "depth"

    def pose(self, state: State) -> Warp | None:
        """The way back from the state; None at rest.

        Raises:
            InputError: the cage is no closed mesh.
        """
        if state.name == CANONICAL:
            return None
        vertices, faces = self.cage
        return cage_warp(vertices, faces, state.move(vertices.double()).to(vertices))

    def draw(self, posed: Warp | None, camera: Camera) -> Image:
        """Take a picture."""
        return self.field.draw(camera, posed)

    def health(self, posed: Warp | None, state: State) -> None:
        """Return nothing: a field has no points."""
        del posed, state

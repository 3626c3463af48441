"""States that an edit file makes: all that points and renderings tell, and true images if given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from pcore.deform.jacobian import unchecked_maps
from pcore.editing.anchors import AnchorRig
from pcore.editing.binding import Bound
from pcore.editing.handles import HandleDiagnosis, handles_of
from pcore.editing.script import EditScript
from pcore.errors import InputError
from pcore.evaluation.states import Shot, State
from pcore.geometry.camera import Camera
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.orbit import growth

EDIT = "edit:"

Subject = tuple[Tensor, AnchorRig | None]
"""Canonical points (N, 3) of a run on the CPU, world units, and its learned rig if it has one."""


class EditedShape:
    """An edit file bound to the clouds of several runs.

    Attributes:
        notes: what is odd about the edits and was not refused.
    """

    def __init__(self, script: EditScript, subjects: Sequence[Subject]) -> None:
        """Bind the script to every cloud.

        Raises:
            EditError: it does not fit one of them, or folds space there.
        """
        self._script = script
        self._known: list[tuple[Tensor, AnchorRig | None, Bound]] = []
        for points, rig in subjects:
            self._known.append((points, rig, script.bound(points, rig=rig)))
        self.notes = tuple(dict.fromkeys(line for *_, one in self._known for line in one.notes))

    def state(self, name: str, shots: Sequence[Shot], center: Tensor) -> State:
        """Return the state for `evaluate`; its cameras step back where the object has grown.

        Args:
            name: of the edit; the state is called `edit:NAME`.
            shots: of the canonical state.
            center: (3,) of the scene, from which cameras step back, world units.
        """
        reach = max(growth(points, one.setting.points, center) for points, _, one in self._known)
        farther = tuple(
            Shot(view=shot.view, camera=_farther(shot.camera, center, reach), depth=None)
            for shot in shots
        )
        return replace(self.against(name, farther, None), has_truth=False)

    def against(self, name: str, shots: Sequence[Shot], object_size: float | None) -> State:
        """Return the state to be scored on true images of another one.

        Args:
            name: of the edit; the state is called `edit:NAME`.
            shots: of the state that the edit is meant to be.
            object_size: of that state (`State`), None where its shape is not known.
        """
        return State(
            name=f"{EDIT}{name}",
            kind="edited",
            shots=tuple(shots),
            move=lambda points: self._of(points)[2].setting.points.to(points),
            local_maps=self._local_maps,
            object_size=object_size,
            handles=self._handles,
        )

    def _local_maps(self, points: Tensor, moved: Tensor) -> LocalMaps:
        del moved  # The edit itself says more than where the points went.
        deformation = self._of(points)[2].deformation
        mended = deformation.mended(points.detach().double()).nonzero().squeeze(-1)
        return replace(unchecked_maps(deformation, points), mended=mended)

    def _handles(self, points: Tensor) -> tuple[HandleDiagnosis, ...]:
        rest, rig, _ = self._of(points)
        return tuple(handles_of(self._script, rest, rig).values())

    def _of(self, points: Tensor) -> tuple[Tensor, AnchorRig | None, Bound]:
        for known in self._known:
            if known[0].shape == points.shape and torch.equal(known[0], points.cpu()):
                return known
        raise InputError(
            f"{self._script.source}: expected points that the edit was bound to, got "
            f"{len(points)} others"
        )


def _farther(camera: Camera, center: Tensor, reach: float) -> Camera:
    pose = camera.world_from_camera.clone()
    middle = center.to(pose)
    pose[:3, 3] = middle + reach * (pose[:3, 3] - middle)
    return camera.moved(pose)

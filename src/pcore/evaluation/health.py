"""What a state does to a method's points: the diagnosis of `pcore.editing`, and what is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from pcore.data.splat import point_picture
from pcore.editing.diagnosis import Diagnosis, diagnose
from pcore.editing.handles import HandleDiagnosis, handle_colors, handle_numbers
from pcore.evaluation.figures import Pixels, color_pixels
from pcore.geometry.camera import Camera
from pcore.geometry.visibility import cloud_spacing, unseen_pixels, unseen_share

HEALTH = (
    "mended_frames",
    "strain_median",
    "strain_99",
    "strain_max",
    "hole_score",
    "hole_score_plain",
    "self_intersection",
    "unseen",
    "anchors_disagree",
    "without_handle",
)
"""Names of the figures, as columns of `images.csv`."""
NO_HEALTH: Mapping[str, float | None] = dict.fromkeys(HEALTH)
"""Figures of what has no points."""

_TINT = (0.98, 0.74, 0.02)
_DOT = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Health:
    """The points of one method in one state.

    Attributes:
        moved: (N, 3) where they are, world units.
        spacing: of the cloud at rest, from `cloud_spacing`.
        unseen: (N,) bool, which of them no training view saw; None where that is not known.
        diagnosis: strain, holes and self-intersection against the rest state.
        handles: of the edits by anchors that made the state; empty for other states.
        mended: how many local maps were replaced because they turned space inside out; None where
            there are none.
    """

    moved: Tensor = field(repr=False)
    spacing: float
    unseen: Tensor | None = field(repr=False)
    diagnosis: Diagnosis = field(repr=False)
    handles: tuple[HandleDiagnosis, ...] = field(repr=False, default=())
    mended: int | None = None

    def shows_unseen(self, camera: Camera, alpha: Tensor) -> Tensor | None:
        """Pixels (H, W) of a rendering that show unseen points; None where that is not known."""
        if self.unseen is None:
            return None
        return unseen_pixels(self.moved, self.unseen, camera, alpha, self.spacing)

    def row(self, shown: Tensor | None, alpha: Tensor) -> dict[str, float | None]:
        """Return the figures of one picture by their names in `HEALTH`.

        Args:
            shown: from `shows_unseen`.
            alpha: (H, W) opacity of the same rendering.
        """
        unseen = None if shown is None else unseen_share(shown, alpha)
        known = {**self.diagnosis.numbers(), **handle_numbers(self.handles), "unseen": unseen}
        known["mended_frames"] = self.mended
        return {name: known.get(name) for name in HEALTH}

    def strain_pixels(self, camera: Camera) -> Pixels:
        """Draw the points in the colours of `Diagnosis.colors`, as a camera sees them."""
        return self._drawn(self.diagnosis.colors(), camera)

    def hole_pixels(self, camera: Camera) -> Pixels:
        """Draw the points in the colours of `Diagnosis.hole_colors`."""
        return self._drawn(self.diagnosis.hole_colors(), camera)

    def handle_pixels(self, camera: Camera) -> Pixels | None:
        """Draw the points in the colours of `handle_colors`; None without edits by anchors."""
        if not self.handles:
            return None
        return self._drawn(handle_colors(self.handles, len(self.moved)), camera)

    def _drawn(self, colors: Tensor, camera: Camera) -> Pixels:
        drawn = point_picture(self.moved, colors, camera, dot=_DOT)
        return np.asarray(drawn.numpy(), dtype=np.uint8)


def health_of(
    rest: Tensor,
    moved: Tensor,
    unseen: Tensor | None,
    handles: tuple[HandleDiagnosis, ...] = (),
) -> Health:
    """Diagnose points (N, 3), at least two, that were moved; with what is known of handles.

    Raises:
        InputError: as `diagnose`.
    """
    before, after = rest.detach().cpu(), moved.detach().cpu()
    return Health(
        moved=after,
        spacing=cloud_spacing(before),
        unseen=unseen,
        diagnosis=diagnose(before, after),
        handles=handles,
    )


def tinted_pixels(rgb: Tensor, shown: Tensor) -> Pixels:
    """Rendering (H, W, 3) whose pixels that show unseen points (H, W) are half yellow."""
    tint = 0.5 * rgb.clamp(0, 1) + 0.5 * torch.tensor(_TINT)
    return color_pixels(torch.where(shown.unsqueeze(-1), tint, rgb))

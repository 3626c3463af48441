"""From edits to what tabs show: splats while things move, exact pictures with the light at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.neural_points import NeuralPoints
from pcore.editing.diagnosis import CALM, LiveDiagnosis, painted
from pcore.editing.handles import handle_colors, handles_in
from pcore.editing.state import EditState
from pcore.errors import PcoreError
from pcore.gaussians.splats import Splats
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.render.picture import RenderCancelledError
from pcore.render.progressive import render_progressively

FOLDED = torch.tensor([220, 30, 30], dtype=torch.uint8)
CHOSEN = torch.tensor([214, 0, 160], dtype=torch.uint8)
_FROZEN = torch.tensor([40, 110, 200], dtype=torch.uint8)
_EXPOSED = torch.tensor([250, 190, 5], dtype=torch.uint8)
_CAMERAS = 20
"""Training views that say what was never seen; each takes milliseconds."""
_SHADE = 40
"""Steps of a colour that differ from calm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dots:
    """Coloured points (N, 3), world units, colours (N, 3) uint8."""

    points: Tensor
    colors: Tensor


class Drawer:
    """Draws one object; keeps what does not change from one state to the next."""

    def __init__(self, asset: Asset) -> None:
        """Prepare its splats, which of neural points takes pictures from all sides."""
        self.asset = asset
        _ = asset.splats_at_rest
        self._baked: tuple[EditState, Posed] | None = None
        self._posed: tuple[EditState, bool, Posed] | None = None
        self._gains: Tensor | None = None
        self._still: Posed | None = None
        self._live = LiveDiagnosis(rest=asset.points, cameras=_training_cameras(asset))
        self._exposed: Tensor | None = None

    @property
    def has_photos(self) -> bool:
        """Whether the views are here that it was trained on."""
        return bool(self._live.cameras)

    def splats(self, state: EditState, eye: Tensor) -> Splats:
        """What a browser draws; the light is the one of the last picture at rest."""
        edited = any(edit.enabled for edit in state.script.edits)
        if not edited:
            return self.asset.splats(None, eye)
        return self.asset.splats(state, eye, gains=self._gains)

    def first(self, state: EditState, *, still: bool) -> Posed | None:
        """The object for a first picture, in the light of the last one at rest.

        None where `posed` has it at once: it is known, or no light has to be found for it.
        """
        if self._known(state, still) or not self._lights(state, still):
            return None
        return self._as_last(state)

    def quick_picture(self, state: EditState, camera: Camera, *, still: bool) -> Image:
        """A small picture for while things move, in the light of the last one at rest."""
        posed = self._known(state, still)
        if posed is None:
            lit = self._lights(state, still)
            posed = self._as_last(state) if lit else self._without_light(state)
        return self.asset.render(posed, camera, fast=True)

    def posed(self, state: EditState, *, still: bool) -> Posed:
        """The object for exact pictures; the last one is kept."""
        if (known := self._known(state, still)) is not None:
            return known
        posed = self._without_light(state)
        if self._lights(state, still):
            posed = self.asset.lit(posed)
        self._posed, self._gains = (state, still, posed), self.asset.gains_of(posed)
        return posed

    def _known(self, state: EditState, still: bool) -> Posed | None:
        known = self._posed
        return known[2] if known and known[0] is state and known[1] == still else None

    def _lights(self, state: EditState, still: bool) -> bool:
        """Whether the light has to be found, which takes longer than all else."""
        return still and state.rays == "aware" and self.asset.light is not None

    def _as_last(self, state: EditState) -> Posed:
        """The object in the light of the last picture at rest."""
        posed = self._without_light(state)
        return posed if self._gains is None else self.asset.lit(posed, self._gains)

    def _without_light(self, state: EditState) -> Posed:
        """The object with the brightness of the photos; the last one is kept."""
        if self._baked is None or self._baked[0] is not state:
            self._baked = (state, self.asset.pose(state, rays=state.rays, light="baked"))
        return self._baked[1]

    def pictures(
        self, posed: Posed, camera: Camera, cancelled: Callable[[], bool]
    ) -> Iterator[Image]:
        """Ever better pictures; ends early where nobody wants them any more."""
        content = self.asset.content
        try:
            if isinstance(content, NeuralPoints):
                with torch.no_grad():
                    yield from render_progressively(
                        content.papr, posed.content, camera, cancel=cancelled
                    )
            else:
                yield self.asset.render(posed, camera, cancel=cancelled)
        except RenderCancelledError:
            return

    def before(self, camera: Camera) -> Image:
        """The object before any edit."""
        if self._still is None:
            self._still = self.asset.pose()
        return self.asset.render(self._still, camera, fast=True)

    def dots(
        self, state: EditState, overlay: str, chosen: frozenset[int], *, moving: bool = False
    ) -> Dots:
        """What is marked: selected points, folds, what an overlay does not find calm.

        Args:
            state: the object.
            overlay: one of `OVERLAYS`.
            chosen: numbers of selected points.
            moving: what came to light is what it was at rest, since views take time.
        """
        colors = painted(CALM).expand(len(state.points), 3).clone()
        if overlay in ("strain", "holes") and len(colors) > 1:
            found = self._live.of(state)
            colors = found.colors() if overlay == "strain" else found.hole_colors()
        elif overlay == "handles":
            found = handles_in(state.bound, state.script)
            colors = handle_colors(found.values(), len(colors))
        away = (colors.int() - painted(CALM).int()).abs().amax(dim=1) > _SHADE
        marks = [(torch.tensor(sorted(chosen)).long(), CHOSEN), (state.folds, FOLDED)]
        if overlay == "exposed" and self._live.cameras:
            marks.insert(0, (self._came_to_light(state, moving), _EXPOSED))
        if overlay == "frozen":
            marks.insert(0, (state.frozen.nonzero().flatten(), _FROZEN))
        for numbers, paint in marks:
            away[numbers], colors[numbers] = True, paint
        return Dots(points=state.points.detach().cpu().float()[away], colors=colors[away])

    def _came_to_light(self, state: EditState, moving: bool) -> Tensor:
        """Numbers of the exposed points; while things move, those of the last time at rest."""
        if self._exposed is None or not moving:
            self._exposed = self._live.exposed(state.points).nonzero().flatten()
        return self._exposed


def _training_cameras(asset: Asset) -> tuple[Camera, ...]:
    """A few cameras of the scene that it was trained on; none where that is not here."""
    try:
        views = asset.scene().split("train")
    except PcoreError:
        return ()
    return tuple(view.camera for view in views[:: max(1, len(views) // _CAMERAS)])

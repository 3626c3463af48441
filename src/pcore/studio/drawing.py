"""From edits to what tabs show: splats while things move, exact pictures with the light at rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.neural_points import NeuralPoints
from pcore.editing.diagnosis import CALM, diagnose, painted
from pcore.editing.state import EditState
from pcore.gaussians.splats import Splats, SplatsAtRest
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.render.picture import RenderCancelledError
from pcore.render.progressive import render_progressively
from pcore.studio.splat_source import gains_of, splats_at_rest

OVERLAYS = ("none", "strain", "holes", "frozen")
FOLDED = torch.tensor([220, 30, 30], dtype=torch.uint8)
CHOSEN = torch.tensor([255, 160, 0], dtype=torch.uint8)
_FROZEN = torch.tensor([40, 110, 200], dtype=torch.uint8)
_SHADE = 12
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
        self._rest: SplatsAtRest = splats_at_rest(asset)
        self._posed: tuple[EditState, bool, Posed] | None = None
        self._gains: Tensor | None = None
        self._still: Posed | None = None

    @property
    def opacities(self) -> Tensor:
        """(N,) of the splats."""
        return self._rest.gaussians.opacities

    def splats(self, state: EditState, eye: Tensor) -> Splats:
        """What a browser draws; the light is the one of the last picture at rest."""
        edited = any(edit.enabled for edit in state.script.edits)
        linear = state.bound.linear if edited else None
        return self._rest.moved(state.points, linear, eye, self._gains if edited else None)

    def posed(self, state: EditState, *, still: bool) -> Posed:
        """The object for exact pictures; the last one is kept."""
        known = self._posed
        if known is None or known[0] is not state or known[1] != still:
            light = None if still and state.rays == "aware" else "baked"
            posed = self.asset.pose(state, rays=state.rays, light=light)
            self._posed, self._gains = (state, still, posed), gains_of(posed)
            return posed
        return known[2]

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


def dots(state: EditState, rest: Tensor, overlay: str, chosen: frozenset[int]) -> Dots:
    """What is marked on the object: selected points, folds, what an overlay does not find calm.

    Args:
        state: the object.
        rest: (N, 3) its points before the edits.
        overlay: one of `OVERLAYS`.
        chosen: numbers of selected points.
    """
    colors = painted(CALM).expand(len(rest), 3).clone()
    moved = state.points.detach().cpu().float()
    if overlay in ("strain", "holes") and len(rest) > 1 and not torch.equal(moved, rest):
        found = diagnose(rest, moved)
        colors = found.colors() if overlay == "strain" else found.hole_colors()
    away = (colors.int() - painted(CALM).int()).abs().amax(dim=1) > _SHADE
    if overlay == "frozen" and state.bound.hold is not None:
        held = state.bound.hold.weight(state.bound.setting.rest) > 0.5
        away, colors[held] = away | held, _FROZEN
    for numbers, paint in ((torch.tensor(sorted(chosen)).long(), CHOSEN), (state.folds, FOLDED)):
        away[numbers], colors[numbers] = True, paint
    return Dots(points=moved[away], colors=colors[away])

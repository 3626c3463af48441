"""A drag over the picture that selects points: brush, lasso, and ball along the surface."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from pcore.editing.picking import pick
from pcore.editing.state import EditState
from pcore.geometry.camera import Camera
from pcore.geometry.point_cloud import size_of
from pcore.studio.selection_editor import SelectionEditor

_CLICK = 4.0
"""Pixels up to which a drag is a click."""


class Stroke:
    """One drag; places are added to it, and it says what they mean so far."""

    def __init__(
        self,
        editor: SelectionEditor,
        camera: Camera,
        *,
        how: str,
        through: bool,
    ) -> None:
        """Begin with no place, with the tool that the editor shows.

        Args:
            editor: whose points are selected.
            camera: of the picture.
            how: "replace", "add" or "subtract"; what a brush passes over is always added.
            through: those behind others, too.
        """
        self._editor, self._through, self.camera = editor, through, camera
        self.tool = editor.shown.tool
        self._how = "add" if self.tool == "brush" and how == "replace" else how
        self._since = editor.shown.chosen
        self._places: list[tuple[float, float]] = []
        self._done, self._painted = 0, torch.zeros(len(editor.asset.points), dtype=torch.bool)

    def add(self, share: tuple[float, float]) -> None:
        """Go on to a place, in shares of the picture from its left and top."""
        self._places.append((share[0] * self.camera.width, share[1] * self.camera.height))

    def apply(self) -> None:
        """Select what it means so far."""
        found = getattr(self, f"_{self.tool}")(self._editor.session.state)
        if found is not None:
            self._editor.choose(found, how=self._how, since=self._since)

    def take_back(self) -> None:
        """Select what was selected before it."""
        self._editor.choose(self._painted & False, how="add", since=self._since)

    @property
    def outline(self) -> Tensor:
        """(S, 2) columns and rows of what shows the tool: the lasso, or the rim of the brush."""
        if self.tool == "lasso":
            return torch.tensor([*self._places, self._places[0]])
        if self.tool == "ball":
            return torch.zeros(0, 2)
        turns = torch.linspace(0, 2 * math.pi, 33)
        circle = torch.stack([turns.cos(), turns.sin()], dim=1)
        return torch.tensor(self._places[-1]) + self._radius * circle

    def _brush(self, state: EditState) -> Tensor:
        new = self._places[max(0, self._done - 1) :]
        self._done = len(self._places)
        painted = self._editor.selector.brush(
            state.points.float().cpu(),
            self.camera,
            torch.tensor(new),
            self._radius,
            through=self._through,
        )
        self._painted |= painted
        return self._painted

    def _lasso(self, state: EditState) -> Tensor:
        points, outline = state.points.float().cpu(), torch.tensor(self._places)
        return self._editor.selector.lasso(points, self.camera, outline, through=self._through)

    def _ball(self, state: EditState) -> Tensor | None:
        first, last = self._places[0], self._places[-1]
        hit = pick(state, self.camera, *first, spacing=self._editor.spacing)
        if hit is None:
            return None
        away, radius = math.dist(first, last), self._editor.shown.brush * self._size
        if away > _CLICK:
            radius = away / self._scale(hit.place)
        return self._editor.selector.geodesic(hit.point, radius) >= 1.0

    def _box(self, state: EditState) -> None:
        """Boxes are drawn by the page."""

    @property
    def _size(self) -> float:
        return size_of(self._editor.asset.points)

    @property
    def _radius(self) -> float:
        """Of the brush, pixels, in the middle of the object."""
        middle = self._editor.session.state.points.detach().cpu().mean(dim=0)
        return max(2.0, self._editor.shown.brush * self._size * self._scale(middle))

    def _scale(self, place: Tensor) -> float:
        """Pixels that a world unit is long at a place (3,)."""
        away = float((place - self.camera.world_from_camera[:3, 3].to(place)).norm())
        return self.camera.focal[0] / max(away, 1e-12)

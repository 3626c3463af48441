"""Assets as methods: one object, one kind of ray, one way to treat the light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

from torch import Tensor

from pcore.asset.asset import Asset, Posed
from pcore.asset.content import LightName, MovedPoints, RaysName
from pcore.errors import EditError
from pcore.evaluation.health import Health, health_of
from pcore.evaluation.runner import Tells
from pcore.evaluation.states import State
from pcore.geometry.camera import Camera
from pcore.render.image import Image

_KEPT = 8
"""Moves of whole clouds that are remembered, for the methods of one object."""

Draw = Callable[[Asset, Posed, Camera], Image]
"""Takes a picture of a posed asset."""


def draw_asset(asset: Asset, posed: Posed, camera: Camera) -> Image:
    """Take it as `Asset.render` does."""
    return asset.render(posed, camera)


@dataclass(frozen=True, kw_only=True, eq=False)
class AssetMethod:
    """An object drawn with one kind of ray.

    All methods are measured by one kind of depth, that of the surface where a run knows it,
    whatever their rays and their light.

    Attributes:
        name: for tables.
        asset: what is drawn, on white.
        rays: how deformed states are seen.
        light: what the light does while points move; "still" needs aware rays.
        unseen: (N,) bool, which points no training view saw; None where that is not known.
        take: takes the pictures.
    """

    name: str
    asset: Asset
    rays: RaysName
    light: LightName = "baked"
    unseen: Tensor | None = None
    take: Draw = draw_asset
    tells: Tells = "depth"

    def pose(self, state: State) -> Posed:
        """Move the asset to a state; methods of one object share the work.

        Raises:
            EditError: the state folds space and rays are aware.
        """
        motion, error = moved(state, self.asset)
        if error is not None and self.rays == "aware":
            raise EditError(f"state {state.name}: {error}; plain rays can draw it") from error
        return self.asset.pose(motion, rays=self.rays, light=self.light)

    def draw(self, posed: Posed, camera: Camera) -> Image:
        """Take a picture."""
        return self.take(self.asset, posed, camera)

    def health(self, posed: Posed, state: State) -> Health:
        """Diagnose its points."""
        found = asset_health(state, self.asset, self.unseen)
        maps = posed.local_maps
        return found if maps is None else replace(found, mended=len(maps.mended))


@lru_cache(maxsize=_KEPT)
def moved(state: State, asset: Asset) -> tuple[MovedPoints, EditError | None]:
    """Where a state takes the points of an asset, and why there may be no local maps."""
    rest = asset.points.detach().cpu()
    positions = state.move(rest)
    try:
        maps = state.local_maps(rest, positions)
    except EditError as error:
        return MovedPoints(positions=positions, world=state.world), error
    return MovedPoints(positions=positions, local_maps=maps, world=state.world), None


@lru_cache(maxsize=_KEPT)
def asset_health(state: State, asset: Asset, unseen: Tensor | None) -> Health:
    """Diagnose the points of an asset in a state."""
    rest = asset.points.detach().cpu()
    handles = () if state.handles is None else state.handles(rest)
    return health_of(rest, moved(state, asset)[0].positions, unseen, handles)

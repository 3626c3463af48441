"""What no light could win more: deformed states with TRUE factors of brightness.

    python -m benchmarks.true_light RUN SCENE [--factor 2] [--every 1] [--states all]

Pictures of aware rays with the light baked in are multiplied by how much brighter the true picture
is than the photos on the true deformed mesh (`baked_light.py`): pixel by pixel, averaged over 0.7
pixels. Beside it the same factors at the points, read off the true pictures where they show the
surface over a point, drawn as estimated ones are. What is missing to the canonical figure then is
not light: pixels that are squeezed or spread, surface that no photo shows, gaps. PSNR of the object
in dB, mean of the views. The states are looked at: nothing may be chosen on this.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from baked_light import foreground_psnr, photo_picture
from light_error import Spots, colours, outwards
from reprojected_truth import PhotoSurface
from scipy.ndimage import gaussian_filter
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import LightName
from pcore.asset.posed_asset import Posed
from pcore.asset.saving import neural_points_of
from pcore.capture.load import load_scene
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.ground_truth import DeformedTruth
from pcore.evaluation.methods import open_subject
from pcore.evaluation.states import CANONICAL, State, open_states
from pcore.geometry.neighbours import nearest
from pcore.geometry.posed import PosedCloud
from pcore.geometry.surface_search import SurfaceSearch

_BLUR = 0.7
_DARK = 0.02
_SOLID = 0.9
_LARGEST = 3.0
_BESIDE = 16
LIGHTS: tuple[LightName, ...] = ("baked", "still")
COLUMNS = ("baked in", "estimated light", "true, points", "true, pixels")


def main() -> None:
    """Print one line per state."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--states", nargs="+", default=["all"])
    wish = parser.parse_args()
    torch.set_num_threads(1)
    places, fine = (open_states(wish.scene, factor=factor) for factor in (wish.factor, 1))
    if places.truth is None:
        raise SystemExit(f"{wish.scene}: no meshes.npz")
    known = TrueLight(open_subject(wish.run), wish.scene, places.truth)
    detailed = {state.name: state for state in fine.select(["all"])}
    print(f"| {wish.scene.name} | {' | '.join(COLUMNS)} |\n|{'---|' * (len(COLUMNS) + 1)}")
    for state in places.select(wish.states):
        scores = known.scores(state, detailed[state.name], wish.every)
        print(f"| {state.name} | {' | '.join(f'{one:.2f}' for one in scores)} |", flush=True)


class TrueLight:
    """A run, and what the true pictures of its scene say about the light."""

    def __init__(self, asset: Asset, scene: Path, truth: DeformedTruth) -> None:
        self._asset, self._truth = asset, truth
        if asset.light is None:
            raise SystemExit(f"{asset.path}: no light; `pcore light` estimates it")
        self._content = neural_points_of(asset, "true light")
        if self._content.surfels is None:
            raise SystemExit(f"{asset.path}: no surfels; `pcore light` estimates them")
        self._surfels = self._content.surfels
        views = load_scene(scene)
        self._photos = PhotoSurface(views, scene / "meshes.npz")
        self._faces = outwards(truth.canonical, truth.faces)
        places = self._surfels.places.double().numpy()
        anchors = SurfaceSearch(truth.canonical, self._faces).closest(places)
        self._spots = Spots(self._faces, anchors.face, anchors.barycentric)
        canonical = truth.canonical
        self._rest = colours(
            *self._spots.of(canonical), views.split("train"), canonical, self._faces
        )

    def scores(self, state: State, detailed: State, every: int) -> tuple[float, ...]:
        """PSNR in dB of the columns."""
        plain, lit = (
            AssetMethod(name="one", asset=self._asset, rays="aware", light=light).pose(state)
            for light in LIGHTS
        )
        vertices = self._truth.vertices(None if state.name == CANONICAL else state.name)
        by_points = self._with_true_gains(lit, detailed, vertices)
        rows: list[tuple[float, ...]] = []
        for shot in state.shots[::every]:
            truth, camera = shot.view.rgba(), shot.camera
            pictures = [self._asset.render(one, camera).rgb for one in (plain, lit, by_points)]
            photos, _ = photo_picture(self._photos, vertices, camera)
            pictures.append(pictures[0] * true_factors(truth, photos).unsqueeze(2))
            rows.append(tuple(foreground_psnr(solid(one), truth) for one in pictures))
        return tuple(statistics.mean(column) for column in zip(*rows, strict=True))

    def _with_true_gains(self, posed: Posed, detailed: State, vertices: np.ndarray) -> Posed:
        """The object with true factors of the points that photos and true pictures show."""
        cloud: PosedCloud = posed.content
        if cloud.surfels is None or cloud.gains is None:
            return posed
        views = [shot.view for shot in detailed.shots]
        there, seen = colours(*self._spots.of(vertices), views, vertices, self._faces)
        before, photographed = self._rest
        known = torch.nonzero((seen > 0) & (photographed > 0) & self._surfels.known).squeeze(1)
        gains = (there.mean(dim=1) + _DARK) / (before.mean(dim=1) + _DARK)
        rest = cloud.cloud.positions
        beside = known[nearest(rest[known], rest, _BESIDE)[0]]
        gains = gains.float().nan_to_num(1.0).clamp(1 / _LARGEST, _LARGEST)
        surfels = replace(cloud.surfels, beside=beside)
        return replace(posed, content=replace(cloud, surfels=surfels, gains=gains))


def solid(rgb: Tensor) -> Tensor:
    """A picture (H, W, 3) on white as opaque RGBA (H, W, 4)."""
    return torch.cat([rgb.clamp(0, 1), torch.ones_like(rgb[..., :1])], dim=2)


def true_factors(truth: Tensor, photos: Tensor) -> Tensor:
    """How much brighter (H, W) a true picture is than photos on the true mesh, both (H, W, 4)."""
    both = ((truth[..., 3] > _SOLID) & (photos[..., 3] > _SOLID)).numpy()
    bright = [one[..., :3].clamp_min(0).mean(dim=2).numpy() + _DARK for one in (truth, photos)]
    ratio = np.where(both, np.log(bright[0] / bright[1]), 0.0)
    share = gaussian_filter(both.astype(np.float64), _BLUR)
    mean = gaussian_filter(ratio, _BLUR) / np.maximum(share, 1e-6)
    object_only = (truth[..., 3] > 0.5).numpy()
    return torch.from_numpy(np.where(object_only, np.exp(mean), 1.0)).float()


if __name__ == "__main__":
    main()

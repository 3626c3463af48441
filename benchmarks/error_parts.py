"""Where the error is: squared error of object pixels by edge, depth jump and interior.

    python -m benchmarks.error_parts RUN SCENE [--factor 2] [--every 3] [--states run twist60]

For the pictures of a run with deformation-aware rays and for the training photos projected on the
true mesh (`baked_light.py`), by state; the canonical state is the first. Object pixels are those
whose true alpha is above one half. "edge" are those within 2 pixels of the silhouette, "jump" the
others where the true depth of neighbouring pixels differs by more than 5 % of the object's size,
"inside" the rest. The three figures of a picture add up to its mean squared error.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from baked_light import photo_picture
from numpy.typing import NDArray
from reprojected_truth import PhotoSurface
from scipy import ndimage
from torch import Tensor

import pcore
from pcore.capture.load import load_scene
from pcore.data.images import composite
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.ground_truth import DeformedTruth
from pcore.evaluation.states import CANONICAL, State, open_states

PARTS = ("edge", "jump", "inside")
_RIM = 2.0
_JUMP = 0.05

Mask = NDArray[np.bool_]


def main() -> None:
    """Print a table: share of the object pixels, and mean squared error by part, in 1e-4."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=3)
    parser.add_argument("--states", nargs="+", default=["all"])
    wish = parser.parse_args()
    torch.set_flush_denormal(True)
    method = AssetMethod(name="run", asset=pcore.load(wish.run), rays="aware")
    places = open_states(wish.scene, factor=wish.factor)
    if places.truth is None:
        raise SystemExit(f"{wish.scene}: no meshes.npz")
    photos = PhotoSurface(load_scene(wish.scene), wish.scene / "meshes.npz")
    kinds = [f"{who} {part}" for who in ("pixels", "run", "photos") for part in PARTS]
    print(f"| state | {' | '.join(kinds)} |\n" + "|---" * (len(kinds) + 1) + "|")
    for state in places.select(wish.states):
        found = measure(method, photos, places.truth, state, wish.every)
        row = [f"{100 * value:.0f} %" for value in found["pixels"]]
        row += [f"{1e4 * value:.1f}" for who in ("run", "photos") for value in found[who]]
        print(f"| {state.name} | {' | '.join(row)} |", flush=True)


def measure(
    method: AssetMethod, photos: PhotoSurface, truth: DeformedTruth, state: State, every: int
) -> dict[str, list[float]]:
    """By picture the parts of its mean squared error, and of the pixels, in the order of PARTS."""
    posed = method.pose(state)
    vertices = truth.vertices(None if state.name == CANONICAL else state.name)
    sums = {who: [0.0] * len(PARTS) for who in ("pixels", "run", "photos")}
    white = torch.ones(3)
    for shot in state.shots[::every]:
        if shot.depth is None or state.object_size is None:
            raise SystemExit(f"state {state.name}: its true shape is not known")
        rgba = shot.view.rgba()
        target = composite(rgba, white)
        pictures = {
            "run": method.asset.render(posed, shot.camera).rgb.clamp(0, 1),
            "photos": composite(photo_picture(photos, vertices, shot.camera)[0], white),
        }
        masks = parts(rgba[..., 3].numpy() > 0.5, shot.depth(), _JUMP * state.object_size)
        for number, mask in enumerate(masks):
            sums["pixels"][number] += float(mask.sum())
            for who, picture in pictures.items():
                error = (picture - target).square().mean(dim=-1).numpy()
                sums[who][number] += float(error[mask].sum())
    total = sum(sums["pixels"])
    return {who: [value / total for value in values] for who, values in sums.items()}


def parts(solid: Mask, depth: Tensor, jump: float) -> tuple[Mask, Mask, Mask]:
    """Masks (H, W) of edge, depth jump and interior; together they are the object."""
    edge = solid & (ndimage.distance_transform_edt(solid) <= _RIM)
    near = depth.numpy().astype(np.float64)
    # The middle of a pixel that is covered for the most part can still miss the object.
    known = solid & np.isfinite(near)
    least = ndimage.minimum_filter(np.where(known, near, np.inf), 3)
    most = ndimage.maximum_filter(np.where(known, near, -np.inf), 3)
    jumps = solid & ~edge & (most - least > jump)
    return edge, jumps, solid & ~edge & ~jumps


if __name__ == "__main__":
    main()

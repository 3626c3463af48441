"""How well the training photos themselves explain a deformed state: a ceiling for baked-in colours.

    python benchmarks/photo_bound.py SCENE [SCENE ...] [--factor 2] [--every 3]

Every pixel of a true picture is traced to the true deformed mesh, carried back to the canonical
surface and looked up in the training photo that sees that spot from the most similar direction.
What is left is light that fell differently, surface no photo shows, and resampling.
"""

from __future__ import annotations

import argparse
import math
import statistics
from pathlib import Path

import numpy as np
import torch
from reprojected_truth import PhotoSurface
from torch import Tensor

from pcore.data.images import area_downscale, composite
from pcore.data.load import load_scene
from pcore.data.sample_render import MeshCaster
from pcore.evaluation.states import open_states
from pcore.geometry.camera import Camera

_SUPERSAMPLING = 2


def main() -> None:
    """Print foreground PSNR by state, mean over every so-manieth test view."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=3)
    wish = parser.parse_args()
    for root in wish.scenes:
        places = open_states(root, factor=wish.factor)
        photos = PhotoSurface(load_scene(root), root / "meshes.npz")
        if places.truth is None:
            raise SystemExit(f"{root}: no meshes.npz")
        for state in places.select(("all",)):
            vertices = places.truth.vertices(None if state.name == "canonical" else state.name)
            scores = [
                foreground_psnr(photo_picture(photos, vertices, shot.camera), shot.view.rgba())
                for shot in state.shots[:: wish.every]
            ]
            print(f"{root.name} {state.name}: {statistics.mean(scores):.2f} dB", flush=True)


def photo_picture(photos: PhotoSurface, vertices: np.ndarray, camera: Camera) -> Tensor:
    """RGBA (H, W, 4) of the deformed mesh in the colours of the photos."""
    fine = camera.resized(camera.width * _SUPERSAMPLING, camera.height * _SUPERSAMPLING)
    directions = fine.rays().flat().directions
    caster = MeshCaster(vertices, photos.faces)
    ray, face, weights = caster.first_hits(
        camera.center.double().numpy(), directions.double().numpy()
    )
    before, after = (mesh[photos.faces[face]] for mesh in (photos.vertices, vertices))
    points = torch.from_numpy(np.einsum("mi,mij->mj", weights, before)).float()
    back = np.linalg.pinv(face_frames(after) @ np.linalg.pinv(face_frames(before)))
    incoming = (torch.from_numpy(back).float() @ directions[ray].unsqueeze(-1)).squeeze(-1)
    colours, _ = photos.colours(points, torch.nn.functional.normalize(incoming, dim=-1))
    rgba = torch.zeros(fine.height * fine.width, 4)
    hit = torch.from_numpy(ray)
    rgba[hit, :3], rgba[hit, 3] = colours, 1.0
    return area_downscale(rgba.reshape(fine.height, fine.width, 4), _SUPERSAMPLING)


def face_frames(corners: np.ndarray) -> np.ndarray:
    """Columns edge, edge, unit normal (M, 3, 3) of triangles (M, 3, 3)."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return np.stack([first, second, normal], axis=2)


def foreground_psnr(rgba: Tensor, truth: Tensor) -> float:
    """PSNR in dB over pixels whose true alpha is above one half, both on white."""
    white = torch.ones(3)
    error = (composite(rgba, white) - composite(truth, white)).square().mean(dim=-1)
    return -10 * math.log10(float(error[truth[..., 3] > 0.5].mean()))


if __name__ == "__main__":
    main()

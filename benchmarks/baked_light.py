"""What remains of a deformed state when light stays baked in: an estimate, no bound.

    python -m benchmarks.baked_light SCENE [SCENE ...] [--factor 2] [--every 1]
    python -m benchmarks.baked_light SCENE --run RUN [--method "aware + P-CORE"]

Every pixel of a true picture is traced to the true deformed mesh, carried back to the canonical
surface and looked up in the training photo that sees that spot from the most similar direction;
surface that no photo shows gets the mean of the 8 nearest colours that one shows. What such a
picture is off by, beyond what the same is off by in the canonical state, is light that fell
differently (and what was invented for unseen surface). With RUN the squared error of a method's
canonical pictures is added to that: the figure a method would have if it lost nothing but the
light and both errors were independent. They need not be, so a method can come out above it. With
RUN the views are those of RUN/eval/images.csv.
"""

from __future__ import annotations

import argparse
import csv
import math
import statistics
from pathlib import Path

import numpy as np
import torch
from reprojected_truth import PhotoSurface
from scipy.spatial import KDTree
from torch import Tensor

from pcore.capture.load import load_scene
from pcore.data.images import area_downscale, composite
from pcore.evaluation.ground_truth import DeformedTruth
from pcore.evaluation.states import CANONICAL, State, open_states
from pcore.geometry.camera import Camera
from pcore.sample.sample_render import MeshCaster

_SUPERSAMPLING = 2
_FILL = 8

Scores = dict[tuple[str, str], dict[str, float]]
"""Method and state -> view -> foreground PSNR."""


def main() -> None:
    """Print one line per state, or a table with the methods of a run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--factor", type=int, default=2)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--states", nargs="+", default=["all"])
    parser.add_argument("--run", type=Path)
    parser.add_argument("--method", default="aware + P-CORE", help="whose canonical error is added")
    wish = parser.parse_args()
    if wish.run is not None and len(wish.scenes) > 1:
        parser.error("--run: expected one scene, that of the run")
    known = {} if wish.run is None else read_scores(wish.run / "eval" / "images.csv")
    if known and (wish.method, CANONICAL) not in known:
        names = ", ".join(sorted({method for method, _ in known}))
        parser.error(f"--method: expected one of {names}, got {wish.method}")
    for root in wish.scenes:
        table(root, wish, known)


def table(root: Path, wish: argparse.Namespace, known: Scores) -> None:
    """Print the states of a scene, the canonical one first."""
    places = open_states(root, factor=wish.factor)
    if places.truth is None:
        raise SystemExit(f"{root}: no meshes.npz")
    photos = PhotoSurface(load_scene(root), root / "meshes.npz")
    names = list(dict.fromkeys(method for method, _ in known))
    print(f"| {root.name} | {' | '.join([*names, 'photos', 'unseen', *['sum'] * bool(names)])} |")
    print("|---" * (len(names) + 3 + bool(names)) + "|")
    rest: dict[str, float] = {}
    for state in places.select(wish.states):
        found, unseen = photo_scores(photos, places.truth, state, wish.every)
        rest = rest or found
        row = [f"{shared(known[name, state.name], found):.2f}" for name in names]
        row += [f"{mean(found):.2f}", f"{100 * unseen:.2f} %"]
        if known:
            still = shared(known[wish.method, CANONICAL], found)
            row.append(f"{baked(still, mean(found), mean(rest)):.2f}")
        print(f"| {state.name} | {' | '.join(row)} |", flush=True)


def read_scores(path: Path) -> Scores:
    """Foreground PSNR by method, state and view, of the standard protocol."""
    scores: Scores = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if row["protocol"] == "standard" and row["foreground_psnr"]:
                views = scores.setdefault((row["method"], row["state"]), {})
                views[row["view"]] = float(row["foreground_psnr"])
    return scores


def photo_scores(
    photos: PhotoSurface, truth: DeformedTruth, state: State, every: int
) -> tuple[dict[str, float], float]:
    """Foreground PSNR by view, and the share of the object that no photo shows."""
    vertices = truth.vertices(None if state.name == CANONICAL else state.name)
    scores: dict[str, float] = {}
    unseen: list[float] = []
    for shot in state.shots[::every]:
        rgba, share = photo_picture(photos, vertices, shot.camera)
        scores[shot.view.name] = foreground_psnr(rgba, shot.view.rgba())
        unseen.append(share)
    return scores, statistics.mean(unseen)


def mean(scores: dict[str, float]) -> float:
    """Mean over the views."""
    return statistics.mean(scores.values())


def shared(scores: dict[str, float], views: dict[str, float]) -> float:
    """Mean over the views that are asked for; all must be there."""
    return statistics.mean(scores[name] for name in views)


def baked(canonical: float, photos: float, photos_canonical: float) -> float:
    """PSNR in dB of the squared error of a method at rest plus what the photos lose."""
    lost = 10 ** (-photos / 10) - 10 ** (-photos_canonical / 10)
    return -10 * math.log10(10 ** (-canonical / 10) + lost)


def photo_picture(
    photos: PhotoSurface, vertices: np.ndarray, camera: Camera
) -> tuple[Tensor, float]:
    """RGBA (H, W, 4) of the deformed mesh in the colours of the photos, and the unseen share."""
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
    colours, seen = photos.colours(points, torch.nn.functional.normalize(incoming, dim=-1))
    rgba = torch.zeros(fine.height * fine.width, 4)
    hit = torch.from_numpy(ray)
    rgba[hit, :3], rgba[hit, 3] = filled(points, colours, seen), 1.0
    picture = area_downscale(rgba.reshape(fine.height, fine.width, 4), _SUPERSAMPLING)
    return picture, 1 - float(seen.float().mean())


def filled(points: Tensor, colours: Tensor, seen: Tensor) -> Tensor:
    """Colours (M, 3) where those of unseen points (M, 3) are the mean of the nearest seen ones."""
    if bool(seen.all()) or not bool(seen.any()):
        return colours
    count = min(_FILL, int(seen.sum()))
    _, index = KDTree(points[seen].numpy()).query(points[~seen].numpy(), k=[*range(1, count + 1)])
    result = colours.clone()
    result[~seen] = colours[seen][torch.from_numpy(index)].mean(dim=1)
    return result


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

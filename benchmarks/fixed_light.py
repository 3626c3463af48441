"""What edited pictures would gain if the light stayed where it is: an experiment, no feature.

    python benchmarks/fixed_light.py RUN SCENE [--factor 2] [--every 4] [--states bend60 run]

Photos have the light baked in, and an edit carries it along: a side that was bent upwards stays as
dark as it was. Here a light is estimated from the training photos, and a deformed picture with
deformation-aware rays is lit anew by it. Logarithms of brightness are the sum of a surface's own
(one of `GROUPS` values, found by colour) and of a light, eight real spherical harmonics (degrees 1
and 2) of the normal: no shadows, no gloss, one light for everything. A point's normal and colour
are means over the training views that see it; a deformation turns the normal by its local map, and
the point gets the factor by which the light on it changes. No true picture of a state and no true
shape takes part, so the figures are what a renderer could reach with such a light.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass

import torch
from error_parts import wish_of_states
from torch import Tensor
from torch.nn import functional as F

from pcore.data.images import composite
from pcore.data.load import load_scene
from pcore.data.scene import View
from pcore.evaluation.image_metrics import psnr
from pcore.evaluation.runner import Method, carry
from pcore.evaluation.states import open_states
from pcore.geometry.point_cloud import PointCloud
from pcore.model.checkpoint import load_model
from pcore.model.papr import Papr, Rendering
from pcore.model.render import normals, render

GROUPS = 6
"""Surfaces of their own brightness, by colour."""
_ROUNDS = 30
_DARKEST = 0.02
_SOLID = 0.9
_ALIKE = 0.8
"""Shortest mean of the unit normals that views see at a point of one surface."""
_LARGEST = 2.5
"""No point gets brighter or darker by more than this factor."""


@dataclass(frozen=True, kw_only=True)
class Surface:
    """What training views see at N points.

    Attributes:
        normals: (N, 3) unit, towards the cameras; zero where none is known.
        colors: (N, 3) mean colour.
        seen: (N,) how much of all views' attention a point got.
        known: (N,) whether the views agree on a normal.
    """

    normals: Tensor
    colors: Tensor
    seen: Tensor
    known: Tensor


def main() -> None:
    """Print PSNR of the object by state, with the light baked in and standing still."""
    wish = wish_of_states(__doc__, every=4)
    torch.set_flush_denormal(True)
    saved = load_model(wish.run)
    papr, cloud = saved.papr(), saved.cloud
    with torch.no_grad():
        surface = observe(papr, cloud, load_scene(wish.scene, factor=wish.factor).split("train"))
        light = fit_light(surface)
        print("light:", " ".join(f"{number:.2f}" for number in light.tolist()))
        print("| state | baked in | standing still |\n|---|---|---|")
        method = Method(name="run", papr=papr, cloud=cloud, aware=True)
        for state in open_states(wish.scene, factor=wish.factor).select(wish.states):
            moved = carry([method], state)["run"]
            gains = light_gains(surface, light, moved)
            scores: dict[str, list[float]] = {"baked": [], "still": []}
            for shot in state.shots[:: wish.every]:
                out, truth = papr(moved, shot.camera.rays()), shot.view.rgba()
                scores["baked"].append(object_psnr(out.rgb, truth))
                scores["still"].append(object_psnr(lit_anew(out, gains), truth))
            row = " | ".join(f"{statistics.mean(values):.2f}" for values in scores.values())
            print(f"| {state.name} | {row} |", flush=True)


def observe(papr: Papr, cloud: PointCloud, views: tuple[View, ...]) -> Surface:
    """Mean normals and colours of the points; every other view is enough."""
    count = len(cloud)
    normal, color, seen = torch.zeros(count, 3), torch.zeros(count, 3), torch.zeros(count)
    for view in views[::2]:
        across = normals(render(papr, cloud, view.camera), view.camera)
        out, photo = papr(cloud, view.camera.rays()), view.rgba()
        used = ~across.isnan().any(dim=-1) & (photo[..., 3] > _SOLID) & (out.alpha > _SOLID)
        weights, points = out.weights[used].flatten(), out.neighbours[used].flatten()
        for total, values in ((normal, across[used]), (color, photo[used][:, :3])):
            each = values.repeat_interleave(out.weights.shape[-1], dim=0)
            total.index_add_(0, points, weights[:, None] * each)
        seen.index_add_(0, points, weights)
    known = (seen > 0.5) & (normal.norm(dim=1) > _ALIKE * seen)
    return Surface(
        normals=F.normalize(normal, dim=1) * known[:, None],
        colors=color / seen.clamp_min(1e-9)[:, None],
        seen=seen,
        known=known,
    )


def harmonics(normal: Tensor) -> Tensor:
    """(N, 8) real spherical harmonics of degrees 1 and 2, not normalised, of (N, 3)."""
    x, y, z = normal.unbind(dim=-1)
    return torch.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1], dim=-1)


def fit_light(surface: Surface, groups: int = GROUPS) -> Tensor:
    """Eight coefficients of the logarithm of brightness: groups and light in turns."""
    basis = harmonics(surface.normals[surface.known]).double()
    color = surface.colors[surface.known].double()
    bright = (color.mean(dim=1) + _DARKEST).log()
    hue = 3 * color / (color.sum(dim=1, keepdim=True) + _DARKEST)
    weights = surface.seen[surface.known].double().sqrt()
    light = _robust(torch.cat([torch.ones_like(basis[:, :1]), basis], dim=1), bright, weights)[1:]
    generator = torch.Generator().manual_seed(0)
    centers: Tensor | None = None
    for _ in range(_ROUNDS):
        own = torch.cat([hue, (bright - basis @ light)[:, None]], dim=1)
        centers = _spread(own, groups, generator) if centers is None else centers
        member = F.one_hot(torch.cdist(own, centers).argmin(dim=1), groups).double()
        sizes = member.sum(dim=0)[:, None]
        centers = torch.where(sizes > 0, member.T @ own / sizes.clamp_min(1), centers)
        light = _robust(torch.cat([member, basis], dim=1), bright, weights)[groups:]
    return light.float()


def _spread(values: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Draw rows far from one another (k-means++)."""
    chosen = values[:1]
    while len(chosen) < count:
        far = torch.cdist(values, chosen).amin(dim=1).square()
        chosen = torch.cat([chosen, values[torch.multinomial(far, 1, generator=generator)]])
    return chosen


def _robust(matrix: Tensor, target: Tensor, weights: Tensor) -> Tensor:
    """Least squares, in which far off rows count less (Huber, at 1.5 median residuals)."""
    found = torch.zeros(matrix.shape[1], dtype=matrix.dtype)
    share = weights
    ridge = 1e-9 * torch.eye(matrix.shape[1], dtype=matrix.dtype)  # A group may be empty.
    for _ in range(8):
        scaled = matrix * share[:, None]
        found = torch.linalg.solve(matrix.T @ scaled + ridge, scaled.T @ target)
        off = (target - matrix @ found).abs()
        share = weights / (off / (1.5 * off.median()).clamp_min(1e-9)).clamp_min(1.0)
    return found


def light_gains(surface: Surface, light: Tensor, moved: PointCloud) -> Tensor:
    """(N,) factor by which the light on every point changes; 1 where its normal is not known."""
    if moved.frames is None:
        return torch.ones(len(moved))
    # A normal turns by the transposed inverse of the local map.
    turned = torch.einsum("nji,nj->ni", moved.frames.to_rest, surface.normals)
    change = harmonics(F.normalize(turned, dim=1)) - harmonics(surface.normals)
    gains = (change @ light).exp().clamp(1 / _LARGEST, _LARGEST)
    return torch.where(surface.known, gains, 1.0)


def lit_anew(out: Rendering, gains: Tensor) -> Tensor:
    """Colours (H, W, 3) over white, every ray's scaled by the weighted factor of its points."""
    empty = (1 - out.alpha).unsqueeze(-1)
    gain = (out.weights * gains[out.neighbours]).sum(dim=-1, keepdim=True)
    return (out.rgb - empty) * gain + empty


def object_psnr(rgb: Tensor, truth: Tensor) -> float:
    """PSNR in dB over the pixels whose true alpha is above one half, on white."""
    return psnr(rgb.clamp(0, 1), composite(truth, torch.ones(3)), truth[..., 3] > 0.5)


if __name__ == "__main__":
    main()

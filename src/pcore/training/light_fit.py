"""Estimate the light of a scene from its training photos and a trained model.

A surface shows its own brightness times the light that falls on it. Points of one material differ
by the light alone, so brightness as a function of the normal, and of what other points hide, tells
the light. Normals and colours of the points are means over the training views that see them;
materials are found by hue and by what brightness the light leaves unexplained, in turns with the
light.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor
from torch.nn import functional as F

from pcore.data.scene import View
from pcore.errors import InputError
from pcore.geometry.light import (
    ENCODING,
    Light,
    Shading,
    irradiance_of,
    known_normals,
    reaching,
    spacing_of,
)
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.model.passes import Picture
from pcore.model.render import normals

DIRECTIONS = 96
MATERIALS = 6
"""Surfaces of a brightness of their own."""
SMOOTH = 0.005
"""Weight of differences between neighbouring directions. Chosen with the two numbers above on two
objects and deformations of our own, rendered with other lights than the benchmark's (ADR 11)."""
_LARGEST_SIDE = 200
_SOLID = 0.9
_ALIKE = 0.8
"""Shortest mean of the unit normals that views see at a point of one surface."""
_SEEN = 0.5
_LEAST_KNOWN = 50
_DARKEST = 0.005
_LEAST_LIGHT = 1e-3
_ROUNDS = 12


@dataclass(frozen=True, kw_only=True)
class Observed:
    """What photos say about N points.

    Attributes:
        normals: (N, 3) unit, outwards; zero where views do not agree on one.
        colors: (N, 3) mean colour.
        attention: (N,) sum of the weights that the pixels of all views gave a point.
    """

    normals: Tensor
    colors: Tensor
    attention: Tensor


Progress = Callable[[int, int], None]


def fit_shading(
    papr: Papr, cloud: PointCloud, views: Sequence[View], *, progress: Progress | None = None
) -> Shading:
    """Estimate light and normals.

    Args:
        papr: a trained model.
        cloud: its canonical points.
        views: training views.
        progress: told (views seen, views in all).

    Raises:
        InputError: too few points have a normal that views agree on.
    """
    observed = observe(papr, cloud, views, progress=progress)
    positions = cloud.positions.detach().cpu()
    reach = reaching(positions, sphere(DIRECTIONS), spacing_of(positions))
    light = fit_light(observed, reach)
    return Shading(light=light, normals=observed.normals, positions=positions)


@torch.no_grad()
def observe(
    papr: Papr, cloud: PointCloud, views: Sequence[View], *, progress: Progress | None = None
) -> Observed:
    """Mean normals and colours of canonical points over views, on the CPU.

    Views are looked at with at most 200 pixels a side; their number of rays per pixel is one.
    """
    device = next(papr.parameters()).device
    cloud = cloud.detached().lit(None).to(device)
    sums = torch.zeros(len(cloud), 7)
    for number, view in enumerate(views, start=1):
        _look(papr, cloud, view, sums)
        if progress is not None:
            progress(number, len(views))
    normal, color, attention = sums[:, :3], sums[:, 3:6], sums[:, 6]
    known = (attention > _SEEN) & (normal.norm(dim=1) > _ALIKE * attention)
    return Observed(
        normals=F.normalize(normal, dim=1) * known[:, None],
        colors=color / attention.clamp_min(1e-9)[:, None],
        attention=attention,
    )


def _look(papr: Papr, cloud: PointCloud, view: View, sums: Tensor) -> None:
    """Add normal, colour and 1 of every pixel to its points, by the weights of their attention."""
    largest = max(view.camera.width, view.camera.height)
    stride = math.ceil(largest / _LARGEST_SIDE)
    camera = view.camera.resized(view.camera.width // stride, view.camera.height // stride)
    rgba = _shrunk(view.rgba(), camera.height, camera.width)
    rays = camera.rays().flat()
    device = cloud.positions.device
    parts = [
        papr.attend(cloud, rays[part].to(device))
        for part in torch.arange(len(rays.origins)).split(8192)
    ]
    shape = camera.height, camera.width
    alpha = (1 - torch.cat([one.background for one, _ in parts])).reshape(shape).cpu()
    surface = torch.cat([one.surface for one, _ in parts]).reshape(*shape, 3).cpu()
    weights = torch.cat([one.weights for one, _ in parts]).reshape(*shape, -1).cpu()
    points = torch.cat([near for _, near in parts]).reshape(*shape, -1).cpu()
    picture = Picture(rgb=rgba[..., :3], alpha=alpha, depth=camera.depth(surface), surface=surface)
    normal = normals(picture, camera)
    used = ~normal.isnan().any(dim=-1) & (alpha > _SOLID)
    if view.has_alpha:
        used &= rgba[..., 3] > _SOLID
    seen = torch.cat([normal, rgba[..., :3], torch.ones(*shape, 1)], dim=-1)[used]
    share = weights[used].unsqueeze(-1) * seen.unsqueeze(1)
    sums.index_add_(0, points[used].flatten(), share.flatten(0, 1))


def _shrunk(rgba: Tensor, height: int, width: int) -> Tensor:
    """Area mean of straight colours (H, W, 4), which only count where they are solid anyway."""
    if rgba.shape[:2] == (height, width):
        return rgba
    return F.interpolate(rgba.permute(2, 0, 1)[None], (height, width), mode="area")[0].permute(
        1, 2, 0
    )


def fit_light(
    observed: Observed,
    reach: Tensor | None = None,
    *,
    materials: int = MATERIALS,
    smooth: float = SMOOTH,
) -> Light:
    """Estimate the light from normals and colours of points: non-negative least squares.

    Brightness b of a point of material m is modelled as a_m E, E the light that falls on it. Given
    the materials' a_m, the radiance solves a robust least squares problem in relative errors, with
    a penalty on differences between neighbouring directions; given the light, points are grouped
    by hue and by what is left of their brightness. A few rounds of both, deterministic.

    Args:
        observed: what photos say about N points.
        reach: (N, D) share of the light from `sphere(DIRECTIONS)` that reaches them past the
            others; None: all of it.
        materials: how many.
        smooth: weight of the penalty.

    Raises:
        InputError: too few points with a normal, or shares of another shape.
    """
    known = known_normals(observed.normals)
    count = int(known.sum())
    if count < _LEAST_KNOWN:
        raise InputError(
            f"light: expected at least {_LEAST_KNOWN} points with a normal that the training views "
            f"agree on, got {count} of {len(known)}; train longer, or do without (--light baked)"
        )
    directions = sphere(DIRECTIONS)
    falling = irradiance_of(observed.normals[known].double(), directions)
    if reach is not None:
        if reach.shape != (len(known), DIRECTIONS):
            raise InputError(
                f"light: expected shares ({len(known)}, {DIRECTIONS}), got {tuple(reach.shape)}"
            )
        falling = falling * reach[known]
    colors = observed.colors[known].double().clamp_min(0)
    bright = (colors + _DARKEST).pow(ENCODING).mean(dim=1)
    hue = 3 * colors / (colors.sum(dim=1, keepdim=True) + 4 * _DARKEST)
    trust = observed.attention[known].double().sqrt()
    trust = trust / trust.mean()
    penalty = smooth * _differences(directions)
    radiance, groups = torch.ones(DIRECTIONS).double(), _Groups(materials)
    member = torch.ones(count, 1).double()
    for _ in range(_ROUNDS):
        for _ in range(2):
            light = (falling @ radiance).clamp_min(_LEAST_LIGHT)
            weights, own = _materials((bright / light).log(), member, trust)
            radiance = _solve(falling, bright / own.exp(), weights / light.square(), penalty)
        left = (bright / (falling @ radiance).clamp_min(_LEAST_LIGHT)).log() / ENCODING
        member = groups(torch.cat([hue, left[:, None]], dim=1))
    return Light(directions=directions, radiance=radiance.float())


def sphere(count: int) -> Tensor:
    """Directions (D, 3) evenly over the sphere: a spiral whose steps turn by the golden angle."""
    step = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * step / count
    turn, flat = math.pi * (1 + math.sqrt(5)) * step, (1 - z * z).sqrt()
    return torch.stack([flat * turn.cos(), flat * turn.sin(), z], dim=1).float()


def _differences(directions: Tensor, neighbours: int = 6) -> Tensor:
    """Quadratic form (D, D) of squared differences between neighbours, their mean."""
    count = len(directions)
    near = (directions @ directions.T).topk(neighbours + 1, dim=1).indices[:, 1:]
    rows = torch.eye(count).double().repeat_interleave(neighbours, dim=0)
    rows = rows - torch.eye(count).double()[near.flatten()]
    return rows.T @ rows / len(rows)


def _materials(left: Tensor, member: Tensor, trust: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (N,) of robust least squares, and the log brightness (N,) of points' materials."""
    weights = own = trust
    for _ in range(3):
        sums = (member.T @ weights).clamp_min(1e-9)
        own = member @ ((member.T @ (left * weights)) / sums)
        off = (left - own).abs()
        # Huber: what is off by more than 1.5 medians pulls no harder than that.
        weights = trust / (off / (1.5 * off.median()).clamp_min(1e-9)).clamp_min(1.0)
    return weights, own


def _solve(falling: Tensor, target: Tensor, weights: Tensor, penalty: Tensor) -> Tensor:
    """Radiance (D,), at least 0 and 1 on average, whose light is nearest to the target (N,)."""
    count, ridge = len(target), 1e-4 / len(penalty)
    scaled = falling * weights[:, None]
    matrix = scaled.T @ falling / count + penalty + ridge * torch.eye(len(penalty)).double()
    pull = (scaled.T @ target / count + ridge).unsqueeze(1)
    solve: Any = nnls
    try:
        root = torch.linalg.cholesky(matrix)
        right = torch.linalg.solve_triangular(root, pull, upper=False)[:, 0]
        found = solve(root.T.numpy(), right.numpy())[0]
    except RuntimeError as error:  # Not positive definite, or no end of iterations.
        raise InputError(
            f"light: the equations have no solution ({error}); do without (--light baked)"
        ) from error
    radiance = torch.from_numpy(np.asarray(found))
    return radiance / radiance.mean().clamp_min(1e-9)


class _Groups:
    """k-means whose centres go on from where they were."""

    def __init__(self, count: int) -> None:
        self._count, self._centers = count, torch.zeros(0)

    def __call__(self, values: Tensor) -> Tensor:
        """Members (N, G), one-hot, of values (N, C)."""
        if len(self._centers) == 0:
            self._centers = self._spread(values)
        member = torch.zeros(0)
        for _ in range(5):
            nearest = torch.cdist(values, self._centers).argmin(dim=1)
            member = F.one_hot(nearest, len(self._centers)).to(values)
            sizes = member.sum(dim=0)[:, None]
            means = member.T @ values / sizes.clamp_min(1)
            self._centers = torch.where(sizes > 0, means, self._centers)
        return member

    def _spread(self, values: Tensor) -> Tensor:
        """Draw values far from one another (k-means++)."""
        generator = torch.Generator().manual_seed(0)
        chosen = values[:1]
        while len(chosen) < self._count:
            far = torch.cdist(values, chosen).amin(dim=1).square()
            if float(far.sum()) == 0:
                break
            drawn = torch.multinomial(far, 1, generator=generator)
            chosen = torch.cat([chosen, values[drawn]])
        return chosen

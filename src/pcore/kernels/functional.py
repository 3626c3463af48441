"""Public face of the kernels: one signature each, the backend chosen by `backends`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import torch
from torch import Tensor
from torch.nn import functional as F

from pcore.errors import InputError
from pcore.geometry.rays import RayBundle
from pcore.kernels import (
    cpu,
    cpu_attention,
    cpu_pull_back,
    cpu_search,
    reference,
    reference_attention,
)
from pcore.kernels.backends import backend, of_attention, of_search, takes_cpu
from pcore.kernels.networks import Layers
from pcore.kernels.shares import background_softmax, cut, pooled_alone


def nearest_to_rays(origins: Tensor, directions: Tensor, points: Tensor, k: int) -> Tensor:
    """Indices of the k points nearest to each ray's infinite line, nearest first.

    Args:
        origins: (..., 3) ray origins.
        directions: (..., 3) unit directions.
        points: (N, 3).
        k: how many; N when there are fewer points.

    Returns:
        (..., min(k, N)) int64 indices; equal distances come in order of the index.

    Raises:
        InputError: without points, or with k < 1.
    """
    if points.shape[0] == 0 or k < 1:
        raise InputError(
            f"nearest_to_rays: expected at least one point and k >= 1, got {points.shape[0]} "
            f"points and k = {k}"
        )
    k = min(k, points.shape[0])
    search = _search(of_search(origins, directions, points, k))
    flat = search(origins.reshape(-1, 3), directions.reshape(-1, 3), points, k)
    return flat.reshape(*origins.shape[:-1], k)


def _search(name: str) -> Callable[[Tensor, Tensor, Tensor, int], Tensor]:
    if name == "triton":
        # Triton is no dependency: it is looked for where it is used.
        from pcore.kernels import triton_search

        return triton_search.nearest_to_rays
    return cpu_search.nearest_to_rays if name == "cpu" else reference.nearest_to_rays


def encode_pairs(
    positions: Tensor,
    origins: Tensor,
    directions: Tensor,
    neighbours: Tensor,
    *,
    scale: float,
    frequencies: tuple[int, int],
) -> tuple[Tensor, Tensor]:
    """Encode where the points lie beside their rays.

    With h the part of (point - origin) along the ray and t the rest (paper, Preliminaries), a row
    is [gamma(scale h), gamma(scale t)]; a part of 0 octaves stays as it is, in world units.

    Args:
        positions: (N, 3).
        origins: (R, 3) ray origins, or (R, k, 3) one per pair.
        directions: unit directions of the same shape.
        neighbours: (R, k) indices into the points.
        scale: factor on positions before they are encoded.
        frequencies: octaves L of the encodings of h and of t.

    Returns:
        The rows (R k, 3 (1 + 2 L_h) + 3 (1 + 2 L_t)), differentiable in positions, origins and
        directions, and the squared distances |t|^2 (R, k), without gradient.
    """
    followed = torch.is_grad_enabled() and directions.requires_grad
    if not takes_cpu(positions) or followed:
        return reference.encode_pairs(
            positions, origins, directions, neighbours, scale=scale, frequencies=frequencies
        )
    if torch.is_grad_enabled() and origins.requires_grad:
        # The kernel's way back ends at the points; offsets from the rays are points, too.
        positions = (positions[neighbours] - reference.per_pair(origins)).flatten(0, 1)
        neighbours = torch.arange(len(positions)).view(neighbours.shape)
        origins = torch.zeros_like(directions)
    origins, directions = origins.detach(), directions.detach()
    return cpu.encode_pairs(
        positions, origins, directions, neighbours, scale=scale, frequencies=frequencies
    )


@dataclass(frozen=True, kw_only=True)
class AttentionRules:
    """What proximity attention is besides its networks.

    Attributes:
        scale: factor on positions before they are encoded.
        frequencies: octaves of gamma(p), gamma(h) and gamma(t).
        background_score: constant score of the background.
        cutoff: points farther than this from a ray get no attention; None lets all answer.
        threshold: values of points with less than this weight are left out, and the weights of
            the others are scaled up to the same sum; the greatest of a ray stays. 0 is exact.
        stop_encoding: no gradient flows through gamma(p), as in the original's training.
    """

    scale: float
    frequencies: tuple[int, int, int]
    background_score: float
    cutoff: float | None = None
    threshold: float = 0.0
    stop_encoding: bool = False


def proximity_attention(
    positions: Tensor,
    features: Tensor,
    influence: Tensor,
    origins: Tensor,
    directions: Tensor,
    neighbours: Tensor,
    *,
    queries: Tensor,
    constants: Tensor,
    key: Layers,
    value: Layers,
    rules: AttentionRules,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Attend from rays to the points nearest to them (paper, Preliminaries).

    With p a point, h and t the parts of its offset from the ray and mu its feature, the key is
    k = standardise(key(standardise([gamma(p), gamma(h), gamma(t)]))), the value is
    v = value([gamma(h), gamma(t), mu]), and the score is influence relu(<query, k> + constant).

    Args:
        positions: (N, 3) points, where the rays see them.
        features: (N, F) vectors mu.
        influence: (N,) factors on the scores.
        origins: (R, 3) ray origins, or (R, k, 3) one per pair.
        directions: unit directions of the same shape.
        neighbours: (R, k) indices into the points.
        queries: (R, D) vectors that the keys are compared with.
        constants: (R,) what is added to the scores of a ray.
        key: embedding network of the keys, to D numbers.
        value: embedding network of the values, to C numbers.
        rules: the rest.

    Returns:
        Features (R, C): weighted values; background (R,): attention that it keeps; weights (R, k):
        attention of the points, renormalised to sum to one, zero where no point is within the
        cut-off; and whether a point is (R, k). The first three are differentiable in everything.
    """
    waves, squared = encode_pairs(
        positions,
        origins,
        directions,
        neighbours,
        scale=rules.scale,
        frequencies=rules.frequencies[1:],
    )
    answering = squared <= (math.inf if rules.cutoff is None else rules.cutoff**2)
    work = _attention(of_attention(positions, key, value, neighbours.shape[1]))
    own = _encoded_points(positions, neighbours, rules)
    # The kernels have no way back through gamma(p).
    scored = reference_attention if own.requires_grad else work
    scores = scored.attention_scores(waves, own, neighbours, answering, queries, key)
    scores = F.relu(scores + constants.unsqueeze(-1))
    scores = scores * influence.index_select(0, neighbours.flatten()).view(neighbours.shape)
    scores = scores.masked_fill(~answering, -math.inf)
    background, weights = background_softmax(scores, rules.background_score)
    used = weights if rules.threshold == 0 else cut(weights, rules.threshold)
    pool = work.attention_features
    # The CPU kernels leave out pairs without weight whatever they are given.
    if rules.threshold > 0 and work is not cpu_attention:
        pool = pooled_alone(pool)
    pooled = pool(waves, features, neighbours, used, value)
    # The last linear layer commutes with the weighted sum: once per ray, not once per pair.
    out = F.linear(pooled, value.weights[-1]) + used.sum(dim=-1, keepdim=True) * value.biases[-1]
    return out, background, weights, answering


def _encoded_points(positions: Tensor, neighbours: Tensor, rules: AttentionRules) -> Tensor:
    """gamma(p) of (N, 3) points, (N, O); zeros in small calls where no ray asks for them.

    The few rays of a second look (layers, turned lines) ask for few of the points, and the encoding
    of all of them would be half of what they cost.
    """
    frequencies = rules.frequencies[0]
    positions = positions.detach() if rules.stop_encoding else positions
    scaled = reference.scaling(rules.scale, frequencies) * positions
    # To know which points are asked for, a GPU must be waited for: not in the steps of a training.
    if torch.is_grad_enabled() or neighbours.numel() >= len(positions):
        return reference.encode(scaled, frequencies)
    used = neighbours.unique()
    encoded = reference.encode(scaled[used], frequencies)
    table = encoded.new_zeros(len(positions), encoded.shape[1])
    return table.index_copy_(0, used, encoded)


def _attention(name: str) -> ModuleType:
    if name == "triton":
        from pcore.kernels import triton_attention

        return triton_attention
    return cpu_attention if name == "cpu" else reference_attention


def pull_back(
    origins: Tensor,
    directions: Tensor,
    positions: Tensor,
    rest: Tensor,
    to_rest: Tensor,
    candidates: Tensor,
    k: int,
    layers: tuple[float, float, float] | None = None,
    back_layer: bool = False,
) -> tuple[Tensor, RayBundle, Tensor, Tensor]:
    """Choose the k candidates nearest to a ray in the rest state, and the ray as each sees it.

    With B the inverse of the map around a point, the ray (o, d) is the ray p + B (o - p'),
    B d / |B d| of the rest state. Nothing is differentiated.

    The foremost point of a ray is the first along it among those that are `close` to the ray they
    see. Of the points after it those are of the back layer from which the ray of the rest state
    passes it `apart`: they never met one ray together. What is farther than `cutoff` from the ray
    it sees gets no attention, and is left in the front layer.

    Args:
        origins: (R, 3) ray origins in the deformed state.
        directions: (R, 3) unit directions.
        positions: (N, 3) deformed points p'.
        rest: (N, 3) points p of the rest state.
        to_rest: (N, 3, 3) the maps B.
        candidates: (R, c) indices into the points, c >= k.
        k: how many to keep.
        layers: the distances close, apart and cutoff, world units of the rest state; None: all
            points are one layer.
        back_layer: keep points of the back layer instead of those of the front layer.

    Returns:
        Neighbours (R, k), nearest first in the rest state, where slots without a point repeat the
        first; rays (R, k) of the rest state as those see them; how many slots hold a point (R,);
        and whether the candidates have a back layer (R,).
    """
    single = positions.dtype == torch.float32
    work = cpu_pull_back if single and backend(positions.device) == "cpu" else reference
    with torch.no_grad():
        return work.pull_back(
            origins, directions, positions, rest, to_rest, candidates, k, layers, back_layer
        )


def rays_at_rest(
    origins: Tensor,
    directions: Tensor,
    positions: Tensor,
    rest: Tensor,
    to_rest: Tensor,
    neighbours: Tensor,
) -> RayBundle:
    """Rays (R, k) of the rest state as points see them; differentiable, what `pull_back` is not.

    Args:
        origins: (R, 3) ray origins in the deformed state.
        directions: (R, 3) unit directions.
        positions: (N, 3) deformed points.
        rest: (N, 3) points of the rest state.
        to_rest: (N, 3, 3) the inverses of the maps around them.
        neighbours: (R, k) indices into the points.
    """
    offset = origins[:, None, :] - positions[neighbours]
    back, turned = reference.turned_back(offset, directions, to_rest[neighbours])
    return RayBundle(origins=rest[neighbours] + back, directions=turned)

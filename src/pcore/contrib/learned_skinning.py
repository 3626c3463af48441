"""Neural Blend Skinning: a network that says how much each anchor carries a point.

Paper, "Application: Skinning Weights Optimization": l(p) = f_phi(gamma(p)), softmax over the 8
nearest anchors. What it leaves open is a field of `SkinningConfig`; how the values were found
stands in docs/adr/0006-skinning.md.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from pcore.deform.anchor_distance import (
    AnchorDistance,
    Candidates,
    PathDistance,
    StraightDistance,
    anchor_spacing,
)
from pcore.deform.skinning import SkinningWeights, gaussian_logits, softmax_weights
from pcore.errors import InputError
from pcore.kernels.reference import encode
from pcore.model.encoding import encoded_size
from pcore.validation import check_count


@dataclass(frozen=True, kw_only=True)
class SkinningConfig:
    """The skinning network and where its weights start."""

    neighbours: int = 8
    """Anchors that may carry a point (paper: K_nn = 8)."""
    frequencies: int = 6
    """Octaves of the encoding of coordinates in [-1, 1]."""
    layers: int = 3
    """Linear layers."""
    width: int = 64
    """Width of the hidden layers."""
    along_cloud: bool = True
    """Whether anchors are near along the cloud; False measures through space, as the paper does."""
    start_sigma: float | None = 0.33
    """Weights start at the Gaussian of this width, in mean anchor spacings; None: all equal."""

    def __post_init__(self) -> None:
        for name in ("neighbours", "frequencies", "layers", "width"):
            check_count(f"skinning: {name}", getattr(self, name))
        if self.start_sigma is not None and not self.start_sigma > 0:
            raise InputError(
                f"skinning: expected start_sigma above 0 or None, got {self.start_sigma}"
            )


class SkinningNetwork(nn.Module):
    """f_phi: points to logits over all anchors; its last layer starts at zero.

    The logits are added to those of the prior, so that an untrained network skins by distance.
    """

    def __init__(self, config: SkinningConfig, anchors: int) -> None:
        super().__init__()
        self.config = config
        sizes = [encoded_size(3, config.frequencies)] + [config.width] * (config.layers - 1)
        self.layers = nn.ModuleList(
            nn.Linear(a, b) for a, b in zip(sizes, [*sizes[1:], anchors], strict=True)
        )
        last = self.layers[-1]
        nn.init.zeros_(last.get_parameter("weight"))
        nn.init.zeros_(last.get_parameter("bias"))
        self.register_buffer("center", torch.zeros(3))
        self.register_buffer("half_size", torch.ones(()))

    def fit_box(self, lower: Tensor, upper: Tensor) -> None:
        """Take the corners (3,) of the cloud's box as the unit of coordinates."""
        self.get_buffer("center").copy_(0.5 * (lower + upper))
        self.get_buffer("half_size").copy_(0.5 * (upper - lower).max())

    def forward(self, points: Tensor) -> Tensor:
        """Logits (N, M) at points (N, 3), world units."""
        local = (points - self.get_buffer("center")) / self.get_buffer("half_size")
        out = encode(local, self.config.frequencies)
        for layer in self.layers[:-1]:
            out = F.relu(layer(out))
        return self.layers[-1](out)


@dataclass(frozen=True, kw_only=True)
class Prior:
    """What distances say about the weights of N points; without gradient.

    Attributes:
        candidates: (N, K) anchors that may carry each point.
        logits: (N, K) where their logits start.
    """

    candidates: Tensor
    logits: Tensor

    def rows(self, chosen: Tensor) -> Prior:
        """Return the prior of some of the points, by index (n,)."""
        return Prior(candidates=self.candidates[chosen], logits=self.logits[chosen])


@dataclass(frozen=True, kw_only=True, eq=False)
class Skinning:
    """A skinning network with the anchors it speaks of: a `Weigher`.

    Attributes:
        network: f_phi, on any device.
        paths: the cloud, its anchors and the paths between them, on the CPU.
    """

    network: SkinningNetwork
    paths: PathDistance = field(repr=False)

    @cached_property
    def distance(self) -> AnchorDistance:
        """Distance by which a point's anchors are found: along the cloud or through space."""
        if self.network.config.along_cloud:
            return self.paths
        return StraightDistance(anchors=self.paths.anchors)

    @property
    def anchors(self) -> Tensor:
        """(M, 3) the anchors, world units."""
        return self.paths.anchors

    @cached_property
    def sigma(self) -> float | None:
        """Width of the Gaussian that weights start at, world units; None for equal weights."""
        spacings = self.network.config.start_sigma
        return None if spacings is None else spacings * anchor_spacing(self.paths.between)

    def __call__(self, points: Tensor) -> SkinningWeights:
        """Weights of points (N, 3), world units, without gradient."""
        with torch.no_grad():
            return self.weights(points, self.prior(points))

    def prior(self, points: Tensor) -> Prior:
        """Find the candidates of points (N, 3): the dear part, done once for points that stay."""
        # Neighbours are searched on the CPU, wherever the points are.
        places = points.detach().cpu()
        found = self.distance.candidates(places, self.network.config.neighbours)
        return Prior(
            candidates=found.anchors.to(points.device), logits=self._start(found).to(points.device)
        )

    def weights(self, points: Tensor, prior: Prior) -> SkinningWeights:
        """Weights of points (N, 3) with their prior, differentiable in the network's parameters."""
        learned = self.network(points).gather(1, prior.candidates)
        return softmax_weights(prior.candidates, prior.logits + learned)

    def _start(self, found: Candidates) -> Tensor:
        if self.sigma is None:
            return torch.zeros_like(found.distances)
        return gaussian_logits(found.distances, self.sigma)


def untrained_skinning(
    distance: PathDistance, config: SkinningConfig, *, seed: int = 0
) -> Skinning:
    """Build a network for the anchors of a cloud; it skins as its prior says until it is fitted.

    Args:
        distance: the cloud, its anchors and the paths between them.
        config: of the network.
        seed: of the hidden layers' weights; the global generator is left alone.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = SkinningNetwork(config, len(distance.indices))
    network.fit_box(distance.points.amin(dim=0), distance.points.amax(dim=0))
    return Skinning(network=network, paths=distance)

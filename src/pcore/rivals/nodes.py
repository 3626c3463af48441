"""SC-GS's rule of editing (Huang et al. 2024): few nodes move, Gaussians follow rigidly.

Nodes are chosen by farthest points among the means of solid Gaussians; the original learns them.
Everything after that follows its published code: docs/research/compare.md says what differs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import KDTree
from torch import Tensor

from pcore.gaussians.covariance import quaternions, rotations
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import PosedGaussians
from pcore.geometry.farthest_points import farthest_points
from pcore.geometry.rotation import nearest_rotation

NODES = 512
"""How many nodes the published commands ask for."""
_SOLID = 0.5
_GRAPH = 3
"""Neighbours of a node along which distances on the surface are added up."""
_FOLLOWED = 8
"""Nodes that a Gaussian follows, and neighbours that a node's turn is taken from."""
_TEMPERATURE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class NodeRig:
    """Gaussians hung on nodes.

    Attributes:
        nodes: (K, 3) at rest, world units, float64.
        followed: (N, k) which nodes each Gaussian follows.
        weights: (N, k) float64, rows sum to 1.
        neighbours: (K, k) of each node, for its turn.
    """

    nodes: Tensor
    followed: Tensor
    weights: Tensor
    neighbours: Tensor


def node_rig(gaussians: Gaussians, *, count: int = NODES, seed: int = 0) -> NodeRig:
    """Choose nodes and hang N Gaussians on them.

    Args:
        gaussians: at rest; at least two solid ones in different places.
        count: of nodes; fewer where there are not as many solid Gaussians.
        seed: of the first node.

    Raises:
        InputError: fewer than two places.
    """
    means = gaussians.means.detach().cpu().double()
    solid = means[gaussians.opacities.detach().cpu() > _SOLID]
    pool = solid if len(solid) > _FOLLOWED else means
    places = len(torch.unique(pool, dim=0))
    nodes = pool[farthest_points(pool, min(count, max(places, 2)), seed=seed)]
    few = min(_FOLLOWED, len(nodes) - 1)
    tree = KDTree(nodes.numpy())
    # A Gaussian asks for the nodes nearest to its own nearest node, along the graph. How far it is
    # from that one stands in the published weights too, and cancels: it is the same for all.
    own = torch.from_numpy(np.asarray(tree.query(means.numpy(), k=1)[1]))
    along = _graph_distances(nodes, tree)
    near, which = torch.topk(along, min(_FOLLOWED, len(nodes)), dim=1, largest=False)
    weights = torch.softmax(-near / _TEMPERATURE, dim=1)
    beside = np.asarray(tree.query(nodes.numpy(), k=few + 1)[1])[:, 1:]
    return NodeRig(
        nodes=nodes,
        followed=which[own],
        weights=weights[own],
        neighbours=torch.from_numpy(beside),
    )


def carried_by_nodes(gaussians: Gaussians, rig: NodeRig, moved: Tensor) -> PosedGaussians:
    """Gaussians after the nodes went to other places; scales and colours stay as they were.

    Args:
        gaussians: N at rest, those of the rig.
        rig: from `node_rig`.
        moved: (K, 3) where the nodes are, world units.
    """
    turns = _turns(rig, moved.double())
    means = gaussians.means.detach().cpu().double()
    offsets = means[:, None] - rig.nodes[rig.followed]
    chosen = turns[rig.followed]
    places = moved.double()[rig.followed] + (chosen @ offsets[..., None]).squeeze(-1)
    blended = (rig.weights[..., None] * quaternions(chosen)).sum(dim=1)
    turned = rotations(blended) @ rotations(gaussians.quats.detach().cpu().double())
    like = gaussians.means
    return PosedGaussians(
        gaussians=replace(
            gaussians,
            means=(rig.weights[..., None] * places).sum(dim=1).to(like),
            quats=quaternions(turned).to(like),
        )
    )


def _turns(rig: NodeRig, moved: Tensor) -> Tensor:
    """Rotations (K, 3, 3) of the nodes; farther neighbours count more, as published."""
    before = rig.nodes[rig.neighbours] - rig.nodes[:, None]
    after = moved[rig.neighbours] - moved[:, None]
    squared = before.square().sum(dim=-1)
    weights = torch.softmax(squared / squared.mean().clamp_min(1e-300), dim=1)
    unit = torch.nn.functional.normalize
    outer = unit(after, dim=-1)[..., :, None] * unit(before, dim=-1)[..., None, :]
    return nearest_rotation((weights[..., None, None] * outer).sum(dim=1)).to(moved)


def _graph_distances(nodes: Tensor, tree: KDTree) -> Tensor:
    """Distances (K, K) along edges to the nearest neighbours; infinite between parts."""
    count = min(_GRAPH, len(nodes) - 1) + 1
    lengths, ends = (np.asarray(one)[:, 1:] for one in tree.query(nodes.numpy(), k=count))
    starts = np.repeat(np.arange(len(nodes)), count - 1)
    graph = csr_matrix((lengths.ravel(), (starts, ends.ravel())), shape=(len(nodes),) * 2)
    return torch.from_numpy(shortest_path(graph, directed=False))

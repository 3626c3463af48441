"""Nearest points, the graph of neighbours of a cloud, and shortest paths over it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee
from scipy.spatial import KDTree
from torch import Tensor

from pcore.errors import InputError
from pcore.geometry.shortest_paths import shortest_paths
from pcore.geometry.torch_threads import use_torch_threads

_BRIDGE_NEIGHBOURS = 32

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def as_points(points: Tensor) -> FloatArray:
    """Return points (N, 3) as float64 for SciPy.

    Raises:
        InputError: no points, another shape, NaN or infinity.
    """
    if points.ndim != 2 or points.shape[1] != 3 or points.shape[0] == 0:
        raise InputError(f"expected points (N, 3), at least one, got {tuple(points.shape)}")
    places: FloatArray = points.detach().cpu().double().numpy()
    bad = int((~np.isfinite(places).all(axis=1)).sum())
    if bad:
        raise InputError(f"expected finite points, got NaN or infinity in {bad} of {len(places)}")
    return places


def nearest(points: Tensor, queries: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Return the k points nearest to every query, nearest first.

    Args:
        points: (N, 3).
        queries: (Q, 3).
        k: how many; N when there are fewer points.

    Returns:
        Indices (Q, k) int64 and distances (Q, k) in the dtype of the queries.
    """
    return nearest_in(KDTree(as_points(points)), queries, k)


def nearest_in(tree: Any, queries: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Do the same with a k-d tree that is kept for many queries."""
    if k < 1:
        raise InputError(f"neighbours: expected k of at least 1, got {k}")
    k = min(k, tree.n)
    places = queries.detach().cpu().double().numpy()
    distance, index = tree.query(places, k=k, workers=torch.get_num_threads())
    shape = (queries.shape[0], k)
    return (
        torch.from_numpy(index.reshape(shape).astype(np.int64)),
        torch.from_numpy(distance.reshape(shape)).to(queries.dtype),
    )


def neighbour_graph(points: Tensor, k: int) -> csr_array:
    """Symmetric graph (N, N): every point linked to its k nearest, links weighing their length.

    Pieces that no link joins are bridged by the shortest links that do (as in a minimum spanning
    tree of the pieces): every point can be reached, and parts that merely come near one another
    are joined in one place, not along their whole length.

    Args:
        points: (N, 3) world units.
        k: links per point.

    Raises:
        InputError: no points, another shape, NaN or infinity, or k below 1.
    """
    places = as_points(points)
    if k < 1:
        raise InputError(f"neighbour graph: expected k of at least 1, got {k}")
    count = len(places)
    workers = torch.get_num_threads()
    _, index = KDTree(places).query(places, k=min(k + 1, count), workers=workers)
    index = np.asarray(index, dtype=np.int64).reshape(count, -1)
    rows, columns = np.repeat(np.arange(count), index.shape[1]), index.ravel()
    graph = _symmetric(places, rows, columns)
    pieces, label = connected_components(graph, directed=False)
    around = KDTree(places).query(places, k=min(_BRIDGE_NEIGHBOURS, count)) if pieces > 1 else None
    while around is not None and pieces > 1:
        links = _bridges(places, label, around)
        rows = np.concatenate([rows, links[:, 0]])
        columns = np.concatenate([columns, links[:, 1]])
        graph = _symmetric(places, rows, columns)
        pieces, label = connected_components(graph, directed=False)
    return graph


def path_lengths(graph: csr_array, sources: Tensor) -> Tensor:
    """Lengths (N, M) float32 of the shortest paths from every node to M sources.

    Args:
        graph: (N, N) from `neighbour_graph`.
        sources: (M,) int64 nodes.
    """
    # Neighbours close to one another in memory: a third less time.
    order = reverse_cuthill_mckee(graph, symmetric_mode=True)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    near = csr_array(graph[order][:, order])
    first, ends = (one.astype(np.int64) for one in (near.indptr, near.indices))
    lengths = near.data.astype(np.float64)
    use_torch_threads()
    found = shortest_paths(first, ends, lengths, place[sources.numpy()])
    return torch.from_numpy(found[place])


def _symmetric(places: FloatArray, rows: IntArray, columns: IntArray) -> csr_array:
    """Both directions of all links, each once, without loops."""
    count = len(places)
    pairs = np.stack([np.minimum(rows, columns), np.maximum(rows, columns)])
    low, high = np.unique(pairs[:, rows != columns], axis=1)
    length = np.linalg.norm(places[low] - places[high], axis=1)
    # SciPy takes a stored zero for no link: points of one place keep a link of next to no length.
    length = np.maximum(length, np.finfo(np.float64).tiny)
    both = np.concatenate([low, high]), np.concatenate([high, low])
    return csr_array(coo_array((np.tile(length, 2), both), shape=(count, count)))


def _bridges(
    places: FloatArray, label: IntArray, around: tuple[FloatArray, Any]
) -> NDArray[np.int64]:
    """Shortest link (C, 2) from each of C pieces to the rest.

    Clouds may fall into thousands of tiny pieces and a few large ones. For a tiny one the few
    nearest points of its points tell; where they cannot, the exact search is made.
    """
    distance, index = around[0], np.asarray(around[1])
    outside = label[index] != label[:, None]
    column = np.where(outside, distance, np.inf).argmin(axis=1)
    own = np.arange(len(places))
    length = np.where(outside[own, column], distance[own, column], np.inf)
    # A point that sees only its own piece is at least this far from all others.
    blind = np.where(np.isinf(length), distance[:, -1], np.inf)
    order = np.lexsort((length, label))
    first = order[np.unique(label[order], return_index=True)[1]]
    bound = np.full(len(first), np.inf)
    np.minimum.at(bound, label, blind)
    links = np.stack([first, index[first, column[first]]], axis=1)
    for piece in np.flatnonzero(bound < length[first]):
        links[piece] = _bridge(places, label == piece)
    return links


def _bridge(places: FloatArray, inside: NDArray[np.bool_]) -> tuple[int, int]:
    """Shortest link between a piece and the rest."""
    own, other = np.flatnonzero(inside), np.flatnonzero(~inside)
    # The tree is built on the larger side: asking is dearer than building.
    swap = len(own) > len(other)
    few, many = (other, own) if swap else (own, other)
    distance, index = KDTree(places[many]).query(places[few])
    best = int(np.argmin(distance))
    return int(few[best]), int(many[np.asarray(index)[best]])

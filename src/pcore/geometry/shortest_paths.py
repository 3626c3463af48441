"""Shortest paths over a graph from many sources at once (compiled, one source per thread)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, parallel=True, nogil=True)
def shortest_paths(
    first: NDArray[np.int64],
    ends: NDArray[np.int64],
    lengths: NDArray[np.float64],
    sources: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Lengths (N, M) of the shortest paths from every node to M sources; infinite for none.

    Dijkstra's algorithm with a binary heap that keeps outdated entries. Lengths are summed in
    float64 from the source on, so that they do not depend on the number of threads.

    Args:
        first: (N + 1,) where the links of each node begin.
        ends: (L,) nodes that links lead to; every link is there in both directions.
        lengths: (L,) of the links, above 0.
        sources: (M,) nodes.
    """
    count = len(first) - 1
    result = np.empty((count, len(sources)), dtype=np.float32)
    for s in numba.prange(len(sources)):
        known = np.full(count, np.inf)
        keys = np.empty(len(ends) + 1)
        nodes = np.empty(len(ends) + 1, dtype=np.int64)
        known[sources[s]], keys[0], nodes[0], size = 0.0, 0.0, sources[s], 1
        while size > 0:
            length, node = keys[0], nodes[0]
            size -= 1
            _sink(keys, nodes, size)
            if length > known[node]:
                continue
            for link in range(first[node], first[node + 1]):
                end, longer = ends[link], length + lengths[link]
                if longer < known[end]:
                    known[end] = longer
                    _rise(keys, nodes, size, longer, end)
                    size += 1
        result[:, s] = known
    return result


@numba.njit(cache=True, nogil=True)
def _sink(keys: NDArray[np.float64], nodes: NDArray[np.int64], size: int) -> None:
    """Put the last of size + 1 entries in the place of the first."""
    key, node, place = keys[size], nodes[size], 0
    while True:
        child = 2 * place + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[place], nodes[place] = keys[child], nodes[child]
        place = child
    keys[place], nodes[place] = key, node


@numba.njit(cache=True, nogil=True)
def _rise(
    keys: NDArray[np.float64], nodes: NDArray[np.int64], size: int, key: float, node: int
) -> None:
    """Add an entry behind `size` others."""
    place = size
    while place > 0:
        parent = (place - 1) // 2
        if keys[parent] <= key:
            break
        keys[place], nodes[place] = keys[parent], nodes[parent]
        place = parent
    keys[place], nodes[place] = key, node

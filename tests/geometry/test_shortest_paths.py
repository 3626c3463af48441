"""Shortest paths: those of another library to the last bit, for any number of threads."""

from __future__ import annotations

import numba
import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pcore.geometry.neighbours import neighbour_graph, path_lengths


def test_lengths_are_those_of_scipy() -> None:
    points = torch.randn(700, 3, dtype=torch.float64)
    points[:200, 0] += 8.0  # Two pieces, joined by a bridge.
    graph, sources = neighbour_graph(points, 5), torch.tensor([3, 150, 420, 699])
    expected = dijkstra(graph, directed=False, indices=sources.numpy()).T.astype(np.float32)
    assert np.array_equal(path_lengths(graph, sources).numpy(), expected)
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert np.array_equal(path_lengths(graph, sources).numpy(), expected)
    finally:
        numba.set_num_threads(threads)


def test_what_no_path_reaches_is_infinitely_far() -> None:
    links = np.array([[0.0, 2.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = path_lengths(csr_array(links), torch.tensor([0]))
    assert found[:, 0].tolist() == [0.0, 2.0, float("inf")]

"""Nearest points and paths over the graph of neighbours."""

import pytest
import torch
from scipy.sparse.csgraph import connected_components

from pcore.errors import InputError
from pcore.geometry.neighbours import nearest, neighbour_graph, path_lengths


def test_nearest_agrees_with_all_distances() -> None:
    points, queries = torch.randn(50, 3), torch.randn(7, 3)
    index, distance = nearest(points, queries, 4)
    expected = torch.cdist(queries, points).sort(dim=1)
    assert torch.equal(index, expected.indices[:, :4])
    torch.testing.assert_close(distance, expected.values[:, :4], atol=1e-6, rtol=1e-5)


def test_fewer_points_than_asked_for() -> None:
    index, distance = nearest(torch.zeros(1, 3), torch.ones(2, 3), 8)
    assert index.shape == distance.shape == (2, 1)


def test_links_are_symmetric_and_as_long_as_their_ends_are_apart() -> None:
    points = torch.randn(80, 3)
    graph = neighbour_graph(points, 5)
    assert abs(graph - graph.T).max() == 0
    rows, columns = graph.nonzero()
    lengths = (points[rows] - points[columns]).double().norm(dim=1)
    torch.testing.assert_close(torch.from_numpy(graph.data), lengths)
    assert (graph.count_nonzero(axis=1) >= 5).all()


def test_paths_follow_the_curve() -> None:
    """On three sides of a square the way from end to end is three sides, not one."""
    line = torch.linspace(0, 1, 51)[:, None]
    up = torch.cat([0 * line, line, 0 * line], dim=1)
    across = torch.cat([line, 1 + 0 * line, 0 * line], dim=1)[1:]
    down = torch.cat([1 + 0 * line, 1 - line, 0 * line], dim=1)[1:]
    points = torch.cat([up, across, down])
    lengths = path_lengths(neighbour_graph(points, 2), torch.tensor([0]))
    assert lengths.shape == (151, 1)
    # Corners may be cut by one link.
    assert float(lengths[-1]) == pytest.approx(3.0, abs=0.03)


def test_pieces_are_bridged_once_where_they_are_nearest() -> None:
    left = torch.rand(40, 3)
    pieces = torch.cat([left, left + 5, left + torch.tensor([5.0, 5.0, -5.0])])
    graph = neighbour_graph(pieces, 3)
    assert connected_components(graph)[0] == 1
    piece = torch.arange(120) // 40
    rows, columns = graph.nonzero()
    crossing = {
        (min(a, b), max(a, b))
        for a, b in zip(rows.tolist(), columns.tolist(), strict=True)
        if piece[a] != piece[b]
    }
    assert len(crossing) == 2
    shortest = torch.cdist(pieces[:40], pieces[40:80]).min()
    assert any(
        float((pieces[a] - pieces[b]).norm()) == pytest.approx(float(shortest), rel=1e-5)
        for a, b in crossing
    )


def test_points_of_one_place_stay_linked() -> None:
    points = torch.cat([torch.zeros(3, 3), torch.ones(1, 3)])
    lengths = path_lengths(neighbour_graph(points, 1), torch.tensor([0]))
    assert lengths[:3].abs().max() < 1e-6
    assert float(lengths[3]) == pytest.approx(3**0.5)


def test_bad_input() -> None:
    with pytest.raises(InputError, match=r"expected points \(N, 3\), at least one, got \(0, 3\)"):
        neighbour_graph(torch.zeros(0, 3), 3)
    with pytest.raises(InputError, match="got NaN or infinity"):
        neighbour_graph(torch.full((4, 3), torch.nan), 3)
    with pytest.raises(InputError, match="expected k of at least 1, got 0"):
        neighbour_graph(torch.rand(4, 3), 0)
    with pytest.raises(InputError, match="expected k of at least 1, got 0"):
        nearest(torch.rand(4, 3), torch.rand(4, 3), 0)

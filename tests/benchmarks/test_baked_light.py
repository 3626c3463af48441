"""The estimate of what baked-in light costs, and where errors are."""

from pathlib import Path

import numpy as np
import pytest
import torch

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")


@pytest.fixture(autouse=True)
def path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(BENCHMARKS)


def test_unseen_surface_takes_the_colours_around_it() -> None:
    from baked_light import filled

    points = torch.rand(200, 3)
    seen = torch.arange(200) >= 30
    colours = torch.where(seen[:, None], points, 0.0)
    result = filled(points, colours, seen)
    assert torch.equal(result[seen], points[seen])
    # A colour that changes smoothly is met to about the spacing; black would be off by 0.5.
    assert float((result - points)[~seen].norm(dim=-1).mean()) < 0.2
    only = filled(points[:5], colours[28:33], seen[28:33])
    torch.testing.assert_close(only[0], colours[30:33].mean(dim=0))


def test_errors_are_added_and_the_rest_state_keeps_its_own() -> None:
    from baked_light import baked

    assert baked(25.0, 30.0, 30.0) == pytest.approx(25.0)
    # Twice the squared error is 3 dB less.
    lost = -10 * np.log10(10**-2.5 + 10**-3.0)
    assert baked(25.0, lost, 30.0) == pytest.approx(25.0 - 10 * np.log10(2))


def test_parts_are_the_object_once() -> None:
    from error_parts import parts

    solid = np.zeros((20, 24), dtype=bool)
    solid[3:17, 2:20] = True
    depth = torch.where(torch.arange(24) < 10, 2.0, 3.0).expand(20, 24).clone()
    depth[~torch.from_numpy(solid)] = torch.inf
    depth[7, 15] = torch.inf  # Covered, but missed in its middle.
    edge, jump, inside = parts(solid, depth, 0.5)
    assert np.array_equal(edge.astype(int) + jump + inside, solid.astype(int))
    assert edge[3:7, 6].tolist() == [True, True, False, False]
    assert jump[8, 8:12].tolist() == [False, True, True, False]
    assert bool(inside[8, 6])


def test_scores_are_read_by_view(tmp_path: Path) -> None:
    from baked_light import read_scores, shared

    text = "method,state,view,protocol,foreground_psnr\na,s,r_0,standard,20\na,s,r_1,standard,30\n"
    (tmp_path / "images.csv").write_text(text + "a,s,r_0,original,99\n")
    scores = read_scores(tmp_path / "images.csv")
    assert scores == {("a", "s"): {"r_0": 20.0, "r_1": 30.0}}
    assert shared(scores["a", "s"], {"r_1": 1.0}) == 30.0

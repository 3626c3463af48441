"""Sessions of one point, and of a third of a million."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pcore.editing.session import EditSession
from pcore.errors import EditError
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.splats import SplatsAtRest

SHIFT = {"type": "rigid", "translation": [0, 0, 0.1]}


def ball(count: int) -> torch.Tensor:
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(2))
    return torch.nn.functional.normalize(points, dim=-1) * 0.9


def edits(points: torch.Tensor, folder: Path) -> list[dict]:
    """One of every kind that can be dragged."""
    mesh = trimesh.creation.icosphere(2, radius=1.2)
    mesh.export(folder / "ball.ply")
    after = (mesh.vertices * [1.0, 1.1, 1.0]).tolist()
    np.save(folder / "before.npy", points.numpy())
    np.save(folder / "after.npy", (points * torch.tensor([1.0, 1.1, 1.0])).numpy())
    place = points[0].tolist()
    return [
        {"type": "twist", "axis": "z", "angle_deg": 5, "extent": [-1, 1]},
        {"type": "anchors", "handles": [{"near": place, "to": [x + 0.02 for x in place]}]},
        {**SHIFT, "region": {"shape": "sphere", "center": place, "radius": 0.2, "falloff": 0.5}},
        {"type": "cage", "before": str(folder / "ball.ply"), "after": after},
        {
            "type": "displacement",
            "before": str(folder / "before.npy"),
            "after": str(folder / "after.npy"),
        },
    ]


def dragged(points: torch.Tensor, edit: dict) -> None:
    """Preview, splats, command, undo: what a hand does."""
    count, session = len(points), EditSession(points)
    state = session.preview(edit, frames="quick")
    assert state.points.shape == points.shape
    assert bool(torch.isfinite(state.bound.linear).all())
    gaussians = Gaussians(
        means=points,
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
        scales=torch.full((count, 3), 0.01),
        opacities=torch.ones(count),
        sh=torch.zeros(count, 1, 3),
    )
    shown = SplatsAtRest.of(gaussians).moved(state.points, state.bound.linear, torch.ones(3))
    assert np.isfinite(shown.covariances).all()
    assert torch.equal(session.do(edit).points, state.points)
    assert torch.equal(session.undo().points, points)


@pytest.mark.parametrize("number", range(5))
def test_one_point_is_dragged_like_many(number: int, tmp_path: Path):
    points = ball(1)
    edit = edits(points, tmp_path)[number]
    if edit["type"] == "anchors":
        # An anchor needs others around it.
        with pytest.raises(EditError):
            EditSession(points).preview(edit)
        return
    dragged(points, edit)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("number", [0, 1, 2, 4])
def test_300_000_points_are_dragged(number: int, tmp_path: Path):
    points = ball(300_000)
    dragged(points, edits(points, tmp_path)[number])

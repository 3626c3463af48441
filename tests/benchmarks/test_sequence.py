"""Edits that the benchmark of sequences compares: many end where one ends."""

import pytest
import torch
from benchmarks.sequence import SMALL, drags, turns

from pcore.editing.session import EditSession

GENERATOR = torch.Generator().manual_seed(0)
POINTS = (torch.rand(2000, 3, generator=GENERATOR) * 2 - 1) * torch.tensor([1.0, 0.2, 1.0])


@pytest.mark.parametrize(("steps", "near"), [(drags, 0.05), (turns, 0.06)])
def test_many_steps_end_near_one(steps, near: float):
    sessions = [EditSession(POINTS) for _ in range(2)]
    for session, count in zip(sessions, (1, SMALL), strict=True):
        edits = steps(POINTS, count)
        assert len(edits) == count
        for edit in edits:
            session.do(edit)
    once, often = (session.state.points for session in sessions)
    hand = POINTS[:, 0].argmin() if steps is drags else (POINTS[:, 0] + POINTS[:, 2]).argmax()
    assert float((once - POINTS)[hand].norm()) > 0.3
    assert torch.allclose(once[hand], often[hand], atol=0.01)
    assert float((once - often).norm(dim=1).mean()) < near

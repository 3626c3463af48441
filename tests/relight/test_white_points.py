"""White points under a processor that flushes denormal numbers, as it does in every command."""

from __future__ import annotations

from pathlib import Path

from tests.forked import Forked

_PAIRS = """
import numpy as np, torch
torch.set_flush_denormal(True)
from pcore.relight.estimate import _drawn
random = np.random.default_rng(0)
hues = random.normal(size=(400, 2))
hues[:200] = 0.0
hues[50] = 1e-17
print(_drawn(hues, 30, 4, random).shape)
"""


def test_many_points_of_no_hue_are_paired(tmp_path: Path, forked: Forked) -> None:
    """In a process of its own: what was wrong was a crash."""
    found = forked.start(_PAIRS, said=tmp_path / "said")
    assert (found.wait(), found.said.read_text()) == (0, "(400, 4)\n")

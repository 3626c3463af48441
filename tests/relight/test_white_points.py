"""White points under a processor that flushes denormal numbers, as it does in every command."""

from __future__ import annotations

import subprocess
import sys

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


def test_many_points_of_no_hue_are_paired() -> None:
    """In a process of its own: what was wrong was a crash."""
    found = subprocess.run(
        [sys.executable, "-c", _PAIRS], capture_output=True, text=True, check=False
    )
    assert (found.returncode, found.stdout.strip()) == (0, "(400, 4)"), found.stderr

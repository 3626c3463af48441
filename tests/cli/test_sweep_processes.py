"""What a trial's processes say when they fail."""

from __future__ import annotations

import pytest

from pcore.cli.sweep_processes import reason_in

_OF_TORCHRUN = """
E1130 10:00:00.0 7 torch/distributed/elastic/multiprocessing/api.py:882] failed (exitcode: 2)
Traceback (most recent call last):
  File "run.py", line 892, in run
torch.distributed.elastic.multiprocessing.errors.ChildFailedError:
============================================================
pcore.cli.main FAILED
  error_file: <N/A>
============================================================
"""


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("Error: train: expected --steps >= 1, got 0", "train: expected --steps >= 1, got 0"),
        ("[rank1]: RuntimeError: out of memory", "out of memory"),
        ("torch.OutOfMemoryError: no room", "no room"),
        ("KeyError: 'w'\n\nThe above was the cause of:\nTrainingError: diverged", "diverged"),
        ("step 3", "no message"),
    ],
)
def test_the_reason_is_the_commands_own(said: str, reason: str) -> None:
    assert reason_in(f"reading\n{said}\n".splitlines()) == reason
    assert reason_in(f"reading\n{said}\n{_OF_TORCHRUN}".splitlines()) == reason

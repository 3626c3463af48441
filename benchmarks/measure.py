"""Time and memory of a call, and the machine that they belong to."""

from __future__ import annotations

import ctypes
import platform
import time
from collections.abc import Callable
from pathlib import Path

import torch

from pcore.kernels.backends import backend

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes: on a GPU by the clock, else in processor seconds.

    Processor seconds count this process alone, so that a busy machine changes little.
    """
    if torch.cuda.is_available():
        torch.cuda.synchronize()
        start = time.perf_counter()
        call()
        torch.cuda.synchronize()
        return time.perf_counter() - start
    start = time.process_time()
    call()
    return time.process_time() - start


def alternating(
    ours: Callable[[], object], other: Callable[[], object], repeats: int
) -> tuple[float, float]:
    """Median seconds of two calls that take turns, after one turn that does not count."""
    times: list[tuple[float, float]] = []
    for _ in range(repeats + 1):
        times.append((seconds(ours), seconds(other)))
    mine, others = torch.tensor(times[1:], dtype=torch.float64).median(dim=0).values.tolist()
    return mine, others


def peak_bytes(call: Callable[[], object]) -> int | None:
    """Return how far a call raises the memory of this process; None where that cannot be seen.

    What a call takes from memory that the process already holds is not seen, so freed memory is
    handed back first.
    """
    try:
        ctypes.CDLL(None).malloc_trim(0)
        _CLEAR.write_text("5", encoding="ascii")
        before = _kilobytes("VmRSS")
        call()
        return 1024 * (_kilobytes("VmHWM") - before)
    except (OSError, AttributeError, TypeError):
        return None


def _kilobytes(field: str) -> int:
    for line in _STATUS.read_text(encoding="ascii").splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1])
    raise OSError(f"{_STATUS} has no {field}")


def machine(device: torch.device, threads: int) -> dict[str, object]:
    """Say where numbers come from."""
    name = torch.cuda.get_device_name() if device.type == "cuda" else platform.machine()
    return {
        "device": name,
        "kernels": backend(device),
        "threads": threads,
        "torch": str(torch.__version__),
        "python": platform.python_version(),
    }

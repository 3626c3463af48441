"""Time and memory of a call, and the machine that they belong to."""

from __future__ import annotations

import ctypes
import platform
import statistics
import time
from collections.abc import Callable, Mapping
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


def in_turns(calls: Mapping[str, Callable[[], object]], turns: int) -> dict[str, float]:
    """Median seconds of calls that take turns, by name, after one turn that does not count."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(turns + 1):
        for name, call in calls.items():
            times[name].append(seconds(call))
    return {name: statistics.median(found[1:]) for name, found in times.items()}


def peak_bytes(call: Callable[[], object], device: torch.device) -> int | None:
    """Return how far a call raises the memory in use; None where that cannot be seen.

    On a GPU it is torch's tensors there. Of this process it is what the system gave: what a call
    takes from memory that the process already holds is not seen, so freed memory is handed back
    first.
    """
    if device.type == "cuda":
        torch.cuda.reset_peak_memory_stats()
        held = torch.cuda.memory_allocated()
        call()
        return torch.cuda.max_memory_allocated() - held
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

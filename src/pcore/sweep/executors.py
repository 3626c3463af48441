"""Where trials run: one after another in this process, or as tasks of Ray."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from pcore.errors import InputError
from pcore.packages import package
from pcore.sweep.sweep_plan import TrialResources
from pcore.sweep.sweep_trial import Runner, Trial, TrialResult, attempt

RETRIES = 5
"""Times that a trial goes on after its worker died; a trial that kills it every time fails."""
_GB = 1e9
_PATIENCE = 10.0
"""Seconds in which a cluster's address must answer."""
_OBJECT_STORE = 100_000_000
"""Bytes that workers share; results are a few hundred."""

Execute = Callable[[Sequence[Trial], Runner], Iterable[TrialResult]]
"""Attempts trials in any order and hands over results as they come."""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What a machine has for trials; `memory` in bytes, None where it is not known."""

    cpus: float
    gpus: float
    memory: float | None = None


def this_machine(cores: int, gpus: int) -> Machine:
    """Describe the machine that this process runs on."""
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # Windows
        memory = None
    return Machine(cpus=cores, gpus=gpus, memory=memory)


def check_resources(wanted: TrialResources, machines: Sequence[Machine]) -> None:
    """Refuse trials that no machine could ever run.

    Raises:
        InputError: none has enough.
    """
    memory = (wanted.memory_gb or 0) * _GB
    for one in machines:
        room = one.memory is None or memory <= one.memory
        if wanted.cores <= one.cpus and wanted.gpus <= one.gpus and room:
            return
    had = "; ".join(_told(one) for one in machines) or "no machine"
    raise InputError(
        f"plan: 'resources': expected a machine with {wanted.cores} CPUs, {wanted.gpus:g} GPUs and "
        f"{memory / _GB:g} GB of memory for each trial, got {had}; ask for less"
    )


def check_workers(wanted: TrialResources, workers: int, machine: Machine) -> None:
    """Refuse more trials at a time than a machine has cores for.

    Raises:
        InputError: it has fewer.
    """
    if workers * wanted.cores > machine.cpus:
        raise InputError(
            f"--workers {workers}: expected at most {machine.cpus // wanted.cores:g}, one for each "
            f"{wanted.cores} of the {machine.cpus:g} cores; give fewer, or fewer CPUs in the plan"
        )


def in_turn(trials: Sequence[Trial], run: Runner) -> Iterable[TrialResult]:
    """Attempt one after another in this process."""
    return (attempt(trial, run) for trial in trials)


@contextmanager
def on_ray(
    wanted: TrialResources, *, address: str | None, workers: int, machine: Machine
) -> Generator[Execute]:
    """Attempt trials as tasks of Ray; what was started for it ends with the context.

    A trial whose worker dies is given to another one, which goes on from the run folder.

    Args:
        wanted: resources of a trial.
        address: of a cluster that shares its disks with this machine; None starts one here.
        workers: trials at a time on this machine; unused with an address.
        machine: this one.

    Raises:
        DependencyError: Ray is not installed.
        InputError: no cluster at the address, or not enough resources.
    """
    with _connected(address, _start(wanted, address, workers, machine)) as (ray, machines):
        check_resources(wanted, machines)
        yield lambda trials, run: _attempt_all(ray, wanted, trials, run)


def machines_of(address: str) -> list[Machine]:
    """Machines of a running Ray cluster.

    Raises:
        DependencyError: Ray is not installed.
        InputError: no cluster at the address.
    """
    with _connected(address, {"address": address, "log_to_driver": False}) as (_, machines):
        return machines


def trials_at_once(wanted: TrialResources, machines: Sequence[Machine]) -> int:
    """How many trials machines have room for together.

    Raises:
        InputError: for none.
    """
    check_resources(wanted, machines)
    return sum(_places(wanted, one) for one in machines)


def _places(wanted: TrialResources, machine: Machine) -> int:
    rooms = [machine.cpus / wanted.cores]
    if wanted.gpus > 0:
        rooms.append(machine.gpus / wanted.gpus)
    if wanted.memory_gb is not None and machine.memory is not None:
        rooms.append(machine.memory / (wanted.memory_gb * _GB))
    return int(min(rooms))


@contextmanager
def _connected(
    address: str | None, start: Mapping[str, Any]
) -> Generator[tuple[Any, list[Machine]]]:
    """Ray, and the machines that it has; what was started for it ends with the context."""
    ray = _ray()
    if address is not None:
        _check_reached(address)
    try:
        ray.init(**start, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise _no_cluster(address, str(error).splitlines()[0]) from error
    try:
        yield ray, [_machine(node["Resources"]) for node in ray.nodes() if node["Alive"]]
    finally:
        ray.shutdown()


def _check_reached(address: str) -> None:
    """Refuse an address where nobody listens; Ray itself would try it for many minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon:
        return  # Words of Ray's own, such as `auto`.
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError, OverflowError) as error:
        raise _no_cluster(address, str(error)) from error


def _no_cluster(address: str | None, why: str) -> InputError:
    return InputError(
        f"--address {address}: expected the address of a running Ray cluster, got none there "
        f"({why}); start one with `ray start --head`"
    )


def _attempt_all(
    ray: Any, wanted: TrialResources, trials: Sequence[Trial], run: Runner
) -> Iterable[TrialResult]:
    task = ray.remote(attempt).options(
        num_cpus=wanted.cores,
        num_gpus=wanted.gpus,
        memory=None if wanted.memory_gb is None else round(wanted.memory_gb * _GB),
        max_retries=RETRIES,
    )
    pending: dict[Any, Trial] = {task.remote(trial, run): trial for trial in trials}
    while pending:
        ready, _ = ray.wait([*pending], num_returns=1)
        trial = pending.pop(ready[0])
        try:
            yield ray.get(ready[0])
        except ray.exceptions.RayError as error:
            told = " ".join(str(error).split())
            failed = f"its worker ended {1 + RETRIES} times, or could not start: {told}"
            yield TrialResult(trial=trial, failed=failed)


def _ray() -> Any:
    # Nothing is reported to anybody.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # What Ray ends because memory is short it would otherwise try again for ever.
    os.environ.setdefault("RAY_task_oom_retries", str(RETRIES))
    # Workers without a GPU keep their view of the machine: pcore is told where to compute.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    return package(
        "ray",
        extra="cluster",
        need="sweeps on several workers need",
        instead="or leave out --workers and --address to run trials in turn",
    )


def _start(
    wanted: TrialResources, address: str | None, workers: int, machine: Machine
) -> Mapping[str, Any]:
    if address is not None:
        return {"address": address, "log_to_driver": False}
    memory = None if machine.memory is None else round(machine.memory)
    return {
        "address": "local",
        "num_cpus": workers * wanted.cores,
        "num_gpus": machine.gpus,
        "_memory": memory,
        "object_store_memory": _OBJECT_STORE,
        "include_dashboard": False,
        "log_to_driver": False,
    }


def _machine(node: Mapping[str, float]) -> Machine:
    return Machine(cpus=node.get("CPU", 0), gpus=node.get("GPU", 0), memory=node.get("memory", 0))


def _told(machine: Machine) -> str:
    memory = "unknown" if machine.memory is None else f"{machine.memory / _GB:.1f} GB of"
    return f"{machine.cpus:g} CPUs, {machine.gpus:g} GPUs, {memory} memory"

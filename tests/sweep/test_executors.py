"""How much of a cluster trials take."""

import os
import socket

import pytest

from pcore.errors import InputError
from pcore.sweep import executors
from pcore.sweep.executors import RETRIES, Machine, machines_of, trials_at_once
from pcore.sweep.sweep_plan import TrialResources


def test_trials_that_a_cluster_has_room_for() -> None:
    machines = [
        Machine(cpus=8, gpus=1, memory=16e9),
        Machine(cpus=4, gpus=0, memory=4e9),
        Machine(cpus=1, gpus=0),
    ]
    assert trials_at_once(TrialResources(), machines) == 13
    assert trials_at_once(TrialResources(cpus=2), machines) == 6
    assert trials_at_once(TrialResources(memory_gb=4), machines) == 4 + 1 + 1
    assert trials_at_once(TrialResources(gpus=0.5), machines) == 2
    assert trials_at_once(TrialResources(cpus=2, processes=2), machines) == 2 + 1
    with pytest.raises(InputError, match="expected a machine with 16 CPUs"):
        trials_at_once(TrialResources(cpus=16), machines)


def test_an_address_where_nobody_listens_is_said_at_once() -> None:
    pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # Ours, and nobody listens.
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match="expected the address of a running Ray cluster, got"):
            machines_of(address)


def test_ray_gives_up_on_what_needs_too_much_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    # Set, so that it is put back as it was; Ray spells its settings in small letters.
    name = "RAY_" + "task_oom_retries"
    monkeypatch.setenv(name, "")
    del os.environ[name]
    executors._ray()
    assert os.environ[name] == str(RETRIES)

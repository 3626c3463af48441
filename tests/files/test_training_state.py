"""The training state: everything comes back, nothing foreign is executed, kills do no harm."""

import signal
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.forked import Forked
from torch import nn

from pcore.errors import CheckpointError
from pcore.files.training_state import (
    TrainingState,
    generator_states,
    load_state,
    restore_generators,
    save_state,
)


def make_state(step: int = 3, **changes: object) -> TrainingState:
    network = nn.Linear(3, 2)
    adam = torch.optim.Adam(network.parameters(), lr=0.1)
    network(torch.ones(3)).sum().backward()
    adam.step()
    values: dict = {
        "stage": "pretrain",
        "step": step,
        "papr": network.state_dict(),
        "cloud": {"positions": torch.randn(4, 3)},
        "optimisers": {"networks": adam.state_dict()},
        "generators": generator_states({"patches": torch.Generator().manual_seed(5)}),
        "best": {
            "psnr": 21.5,
            "step": 2,
            "weights": {"w": torch.zeros(2)},
            "numpy": np.random.default_rng(0).bit_generator.state,
            "order": [2, 0, 1],
        },
        "skinning": {"layers.0.weight": torch.randn(2, 2)},
    }
    return TrainingState(**{**values, **changes})


def assert_same(a: object, b: object) -> None:
    if isinstance(a, torch.Tensor):
        assert isinstance(b, torch.Tensor)
        assert a.dtype == b.dtype
        assert torch.equal(a, b)
    elif isinstance(a, dict):
        assert isinstance(b, dict)
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    else:
        assert type(a) is type(b)
        assert a == b


def error_of(path: Path) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_state(path)
    return str(caught.value)


def test_everything_comes_back(tmp_path: Path) -> None:
    state, path = make_state(), tmp_path / "state.pt"
    save_state(path, state)
    loaded = load_state(path)
    for name in ("stage", "step", "cloud", "generators", "best", "skinning"):
        assert_same(getattr(state, name), getattr(loaded, name))
    assert_same(dict(state.papr), loaded.papr)
    assert_same(state.optimisers, loaded.optimisers)


def test_a_state_without_an_entry(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    save_state(path, make_state())
    content = torch.load(path, weights_only=True)
    del content["state"]["skinning"]
    torch.save(content, path)
    assert "missing, unknown or ill-typed entries skinning" in error_of(path)


def test_an_optimiser_goes_on_bitwise_as_if_never_stopped(tmp_path: Path) -> None:
    def step(network: nn.Linear, adam: torch.optim.Optimizer, draw: torch.Generator) -> None:
        adam.zero_grad()
        network(torch.randn(3, generator=draw) + torch.rand(3)).square().sum().backward()
        adam.step()

    def begin() -> tuple[nn.Linear, torch.optim.Optimizer, torch.Generator]:
        torch.manual_seed(1)
        network = nn.Linear(3, 2)
        return network, torch.optim.Adam(network.parameters(), lr=0.1), torch.Generator()

    network, adam, draw = begin()
    for _ in range(6):
        step(network, adam, draw)
    expected = network.weight.detach().clone()

    network, adam, draw = begin()
    for _ in range(3):
        step(network, adam, draw)
    state = make_state(
        papr=network.state_dict(),
        optimisers={"a": adam.state_dict()},
        generators=generator_states({"draw": draw}),
    )
    save_state(tmp_path / "state.pt", state)
    network, adam, draw = begin()
    loaded = load_state(tmp_path / "state.pt")
    network.load_state_dict(loaded.papr)
    adam.load_state_dict(loaded.optimisers["a"])
    restore_generators({"draw": draw}, loaded.generators)
    for _ in range(3):
        step(network, adam, draw)
    assert torch.equal(network.weight, expected)


def test_views_do_not_drag_their_storage_into_the_file(tmp_path: Path) -> None:
    path = tmp_path / "state.pt"
    save_state(path, make_state(best={"w": torch.randn(1_000_000)[:10]}))
    assert path.stat().st_size < 100_000
    assert load_state(path).best["w"].shape == (10,)


def test_objects_are_refused_when_saving_and_named(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"state\.best\.mean is a float64"):
        save_state(tmp_path / "state.pt", make_state(best={"mean": np.float64(1.0)}))
    assert not (tmp_path / "state.pt").exists()


def test_missing(tmp_path: Path) -> None:
    assert "no training state at" in error_of(tmp_path / "state.pt")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.999])
def test_truncated(tmp_path: Path, share: float) -> None:
    path = tmp_path / "state.pt"
    save_state(path, make_state())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "truncated or not a file of torch" in error_of(path)


def test_a_flipped_bit_is_found(tmp_path: Path) -> None:
    path, weights = tmp_path / "state.pt", torch.randn(1000)
    save_state(path, make_state(best={"w": weights}))
    content = bytearray(path.read_bytes())
    content[content.index(weights.numpy().tobytes()) + 400] ^= 1
    path.write_bytes(content)
    assert "is damaged: the checksum of" in error_of(path)


class Bomb:
    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple:
        return Path.touch, (self.target,)


def test_a_pickle_that_is_no_state_is_not_executed(tmp_path: Path) -> None:
    path, mark = tmp_path / "state.pt", tmp_path / "executed"
    torch.save({"format": "pcore-state", "bomb": Bomb(mark)}, path)
    assert "nothing in it was executed" in error_of(path)
    assert not mark.exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"weights": 1}, "is not a training state of pcore"),
        (torch.zeros(2), "is not a training state of pcore"),
        ({"format": "pcore-state", "version": 2}, "has version 2 of the state format"),
        ({"format": "pcore-state", "version": 3, "state": {"step": 1.5}}, "entries best"),
    ],
)
def test_not_ours_or_of_another_version(tmp_path: Path, content: object, message: str) -> None:
    torch.save(content, tmp_path / "state.pt")
    assert message in error_of(tmp_path / "state.pt")


def test_other_generators_than_saved_are_named() -> None:
    states = generator_states({"patches": torch.Generator()})
    with pytest.raises(CheckpointError, match=r"expected random generators \['views'\], got"):
        restore_generators({"views": torch.Generator()}, states)


SAVER = """
import sys, torch
from pathlib import Path
from pcore.files.training_state import TrainingState, save_state
torch.set_num_threads(1)
step = 0
while True:
    step += 1
    full = torch.full((200_000,), float(step))
    save_state(Path(sys.argv[1]), TrainingState(stage="pretrain", step=step,
        papr={"w": full}, cloud={"positions": full}, optimisers={}, generators={}))
    if step <= 2:
        print("saved", flush=True)
"""


def test_a_kill_at_any_moment_leaves_one_consistent_state(tmp_path: Path, forked: Forked) -> None:
    path = tmp_path / "state.pt"
    rng = np.random.default_rng(0)
    for number, delay in enumerate(rng.uniform(0.0, 0.15, 5)):
        process = forked.start(SAVER, str(path), said=tmp_path / f"said-{number}")
        process.says("saved\n", times=2)
        time.sleep(delay)
        assert process.end() == -signal.SIGKILL
        state = load_state(path)
        assert state.step >= 2
        assert torch.equal(state.papr["w"], torch.full((200_000,), float(state.step)))
        assert torch.equal(state.papr["w"], state.cloud["positions"])

"""torch.compile of the networks: once, whatever the population does, and no other weights' names.

Compiled to run as it is (backend "eager"): the machine of the tests has no GPU.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor, nn
from torch._dynamo.testing import CompileCounter
from torch.fx import GraphModule

from pcore.data.scene import Scene
from pcore.errors import InputError, TrainingError
from pcore.files.run_folder import RunFolder
from pcore.files.training_state import TrainingState
from pcore.metrics.perceptual import Lpips
from pcore.training import compiling, losses
from pcore.training.config import GrowConfig, PretrainConfig, PruneConfig
from pcore.training.events import PopulationReport
from pcore.training.finetune import finetune
from pcore.training.pretrain import pretrain
from small_training import Heard, assert_same, finetune_config, pretrain_config, weights_of

# Torch's own, while it looks at what the attention hands to the renderer.
pytestmark = pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor:UserWarning")


class Difference(nn.Module):
    """A perceptual network for the small patches of the tests."""

    def forward(self, first: Tensor, second: Tensor) -> Tensor:
        return (first - second).abs().mean(dim=(1, 2, 3))


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> CompileCounter:
    """Compile on the CPU, too, and count how often."""
    torch.compiler.reset()
    counter = CompileCounter()
    monkeypatch.setattr(compiling, "is_worth_compiling", lambda device: True)
    monkeypatch.setattr(compiling, "BACKEND", counter)
    return counter


def saved(scene: Scene, config: PretrainConfig, path: Path, *, compiled: bool) -> TrainingState:
    with RunFolder.create(path, stage="pretrain", scene="box", config={}, resume=False) as folder:
        pretrain(scene, config, folder=folder, compiled=compiled)
        state = folder.load_state()
        assert state is not None
        return state


def test_one_compilation_over_pruning_growing_and_further_trainings(
    box: Scene, counter: CompileCounter, tmp_path: Path
) -> None:
    config = pretrain_config(
        # 11 of 60 points, whichever kernels and however many threads.
        prune=PruneConfig(every=4, first=4, last=4, threshold=1.01),
        grow=GrowConfig(every=6, first=6, last=6, count=7, limit=90),
    )
    expected = pretrain(box, config, compiled=False)
    assert counter.frame_count == 0, "switched off"
    heard = Heard()
    found = pretrain(box, config, listener=heard)
    population = heard.of(PopulationReport)
    assert sum(event.pruned for event in population) > 0
    assert sum(event.grown for event in population) == 7
    assert counter.frame_count == 1
    # The same operations in the same order: the very same weights, under the same names.
    assert_same(weights_of(found), weights_of(expected))
    finetune(box, found, finetune_config())
    assert counter.frame_count == 1, "the same sizes in another training"
    with_it = saved(box, config, tmp_path / "with", compiled=True)
    without = saved(box, config, tmp_path / "without", compiled=False)
    assert_same(dict(with_it.papr), dict(without.papr))


def test_the_perceptual_network_is_compiled_whole(counter: CompileCounter) -> None:
    torch.manual_seed(0)
    network, (one, other) = Lpips("squeeze"), torch.rand(2, 1, 3, 40, 40)
    expected, keys = network(one, other), list(network.state_dict())
    compiling.compile_networks(torch.device("cpu"), network, None)
    assert torch.equal(network(one, other), expected)
    assert torch.equal(network(other, one), expected)
    assert counter.frame_count == 1
    assert list(network.state_dict()) == keys


def test_the_perceptual_network_of_a_training_is_compiled(
    box: Scene, counter: CompileCounter, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = pretrain_config(steps=2, lpips_weight=0.01)
    monkeypatch.setattr(losses, "load_lpips", lambda trunk, device: Lpips("squeeze"))
    with pytest.raises(InputError, match="at least 32 x 32 pixels, got 16 x 16"):
        pretrain(box, config)
    before = counter.frame_count
    monkeypatch.setattr(losses, "load_lpips", lambda trunk, device: Difference())
    pretrain(box, config)
    assert (before, counter.frame_count) == (1, 2), "the renderer, and then this network, too"


def test_the_cpu_compiles_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted: list[object] = []
    network = SimpleNamespace(compile=wanted.append)
    compiling.compile_networks(torch.device("cpu"), network)
    assert wanted == []
    assert compiling.is_worth_compiling(torch.device("cuda"))
    assert not compiling.is_worth_compiling(torch.device("cpu"))


def test_what_cannot_be_compiled_is_an_error_that_says_how_to_go_on(
    box: Scene, counter: CompileCounter, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(graph: GraphModule, inputs: list[Tensor]) -> None:
        raise OSError("no C compiler")

    monkeypatch.setattr(compiling, "BACKEND", broken)
    with pytest.raises(TrainingError, match=r"torch\.compile: .* --no-compile"):
        pretrain(box, pretrain_config())


def test_other_errors_are_not_the_compilers() -> None:
    with pytest.raises(RuntimeError, match="something else"), compiling.compiler_errors_explained():
        raise RuntimeError("something else")

"""The file of a light: everything comes back, and what is wrong is said."""

from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from pcore.errors import CheckpointError
from pcore.relight.lamps import Light
from pcore.relight.light_file import LIGHT_FILE, load_light, save_light
from pcore.relight.relight_config import RelightConfig
from pcore.relight.relighting import Relighting

POINTS = torch.rand(7, 3, generator=torch.Generator().manual_seed(1))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    light = Light(
        directions=torch.eye(3),
        radiance=torch.tensor([0.0, 1.0, 2.0]),
        nearness=torch.tensor([0.0, 0.1, 0.3]),
        center=torch.tensor([1.0, 2.0, 3.0]),
    )
    relighting = Relighting(
        light=light,
        positions=POINTS,
        brightness=torch.arange(7) / 7,
        received=1 + torch.arange(7) / 7,
        config=RelightConfig(largest_gain=3.0),
    )
    save_light(tmp_path / LIGHT_FILE, relighting)
    return tmp_path / LIGHT_FILE


def rewrite(path: Path, header: dict[str, str] | None = None, **tensors: torch.Tensor) -> None:
    with safe_open(path, framework="pt") as file:
        content = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        lines = dict(file.metadata())
    save_file({**content, **tensors}, path, metadata={**lines, **(header or {})})


def error_of(path: Path, points: torch.Tensor = POINTS) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_light(path, points)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_everything_comes_back(path: Path) -> None:
    for where in (path, path.parent):
        found = load_light(where, POINTS)
        assert torch.equal(found.positions, POINTS)
        assert torch.equal(found.light.directions, torch.eye(3))
        assert found.light.radiance.tolist() == [0.0, 1.0, 2.0]
        assert torch.equal(found.light.nearness, torch.tensor([0.0, 0.1, 0.3]))
        assert found.light.center.tolist() == [1.0, 2.0, 3.0]
        assert torch.equal(found.brightness, torch.arange(7) / 7)
        assert torch.equal(found.received, 1 + torch.arange(7) / 7)
        assert found.config == RelightConfig(largest_gain=3.0)


def test_missing_and_damaged(path: Path) -> None:
    assert "`pcore light RUN`" in error_of(path.with_name("other.safetensors"))
    path.write_bytes(path.read_bytes()[:40])
    assert "damaged or not a safetensors file" in error_of(path)


def test_another_format_or_version(path: Path) -> None:
    rewrite(path, {"version": "2"})
    said = error_of(path)
    assert "version 4, got 'pcore-light' of version '2'" in said
    assert "`pcore light RUN`" in said, "a light of before knows no surface: how to get one"
    rewrite(path, {"format": "pcore-model", "version": "4"})
    assert "got 'pcore-model'" in error_of(path)


def test_the_light_of_other_points(path: Path) -> None:
    assert "got 7 others" in error_of(path, POINTS + 0.1)
    assert "got 6 others" in error_of(path, POINTS[:6])


def test_bad_numbers(path: Path) -> None:
    rewrite(path, radiance=torch.tensor([0.0, float("nan"), 1.0]))
    assert "NaN or infinity in radiance" in error_of(path)
    rewrite(path, radiance=torch.tensor([0.0, -1.0, 1.0]))
    assert "radiance of 0 or more" in error_of(path)
    rewrite(path, radiance=torch.ones(3), directions=torch.tensor(1.0))
    assert "directions (D, 3)" in error_of(path)
    rewrite(path, directions=torch.eye(3), radiance=torch.ones(3, dtype=torch.int64))
    assert "float32 throughout" in error_of(path)
    rewrite(path, radiance=torch.ones(3), nearness=-torch.ones(3))
    assert "nearness of 0 (far away) or more" in error_of(path)
    rewrite(path, nearness=torch.zeros(3), brightness=torch.ones(6))
    assert "brightness (N,) and received light (N,)" in error_of(path)
    rewrite(path, brightness=torch.ones(7), received=torch.zeros(7))
    assert "finite light above 0" in error_of(path)
    rewrite(path, {"config": "{"}, received=torch.ones(7))
    assert "expected a JSON object under 'config' of the header, got '{'" in error_of(path)
    rewrite(path, {"config": "{}"})
    assert "missing key 'encoding'" in error_of(path)

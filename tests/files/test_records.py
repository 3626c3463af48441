"""Dataclasses to JSON and back."""

from dataclasses import dataclass, field

import pytest

from pcore.errors import CheckpointError, InputError
from pcore.files.records import differing_keys, from_dict, to_dict
from pcore.model.papr_config import PaprConfig


@dataclass(frozen=True, kw_only=True)
class Inner:
    rate: float = 0.5
    pair: tuple[int, int] = (1, 2)


@dataclass(frozen=True, kw_only=True)
class Outer:
    steps: int
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if self.steps < 0:
            raise InputError(f"expected steps of at least 0, got {self.steps}")


GOOD = {"steps": 3, "inner": {"rate": 2.0, "pair": [3, 4]}}


def test_round_trip() -> None:
    record = from_dict(Outer, GOOD, where="x")
    assert record == Outer(steps=3, inner=Inner(rate=2.0, pair=(3, 4)))
    assert to_dict(record) == GOOD


def test_every_value_of_a_model_configuration_comes_back() -> None:
    config = PaprConfig(neighbours=7, cutoff=0.25, unet_channels=(8, 16, 32))
    assert from_dict(PaprConfig, to_dict(config), where="x") == config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": 1}, "unknown key 'speed'"),
        ({"inner": {**GOOD["inner"], "width": 1}}, "unknown key 'inner.width'"),
        ({"inner": {"pair": [1, 2]}}, "missing key 'inner.rate'"),
        ({"steps": "3"}, "'steps': input should be a valid integer, got '3'"),
        ({"inner": {"rate": "x", "pair": [1, 2]}}, "'inner.rate': input should be a valid number"),
        ({"steps": -1}, "expected steps of at least 0, got -1"),
    ],
)
def test_what_does_not_fit_is_named(change: dict, message: str) -> None:
    with pytest.raises(CheckpointError) as caught:
        from_dict(Outer, {**GOOD, **change}, where="RUN/file: config")
    assert message in str(caught.value)
    assert str(caught.value).startswith("RUN/file: config: ")
    assert "another version" in str(caught.value)


def test_a_missing_key_is_not_filled_in_by_a_default() -> None:
    with pytest.raises(CheckpointError, match="missing key 'steps'"):
        from_dict(Outer, {"inner": GOOD["inner"]}, where="x")
    with pytest.raises(CheckpointError, match="missing key 'inner'"):
        from_dict(Outer, {"steps": 1}, where="x")


def test_differences_are_named_by_dotted_keys() -> None:
    old = {"a": {"b": 1, "c": 2}, "gone": 0}
    new = {"a": {"b": 1, "c": 3}, "new": 5, "unused": None}
    assert differing_keys(old, new) == [
        "a.c: 2 -> 3",
        "gone: 0 -> (absent)",
        "new: (absent) -> 5",
    ]
    assert differing_keys(old, old) == []

"""Checkpoints of the original from before June 2024: other names, the same pictures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from test_official import State, load, official_state, render, view, yaml_tree

from pcore.cli.main import main
from pcore.errors import CheckpointError
from pcore.files.official import load_official

WIDTH = 16


def older_names(state: State) -> State:
    """The same weights as the original saved them then, with layers that it never called."""
    attention = "proximity_attn.attention_layer."
    old = {
        name.replace(attention, "transformer.blocks.0.").replace(
            "proximity_attn.", "transformer."
        ): v
        for name, v in state.items()
    }
    block = "transformer.blocks.0."
    for layer in ("w_v", "w_o"):
        old |= {f"{block}{layer}.weight": torch.randn(WIDTH, WIDTH)}
        old |= {f"{block}{layer}.bias": torch.zeros(WIDTH)}
    for norm in ("innorm", "outnorm"):
        old |= {f"{block}ff.{norm}.{leaf}": torch.ones(WIDTH) for leaf in ("a_2", "b_2")}
    for number in (1, 3):
        old |= {f"{block}ff.mlp.model.{number}.bias": torch.zeros(WIDTH)}
        old |= {f"{block}ff.mlp.model.{number}.weight_g": torch.ones(WIDTH, 1)}
        old |= {f"{block}ff.mlp.model.{number}.weight_v": torch.randn(WIDTH, WIDTH)}
    return old


def older_tree(**block: Any) -> dict[str, Any]:
    """Sections of the configurations of that time."""
    tree = yaml_tree()
    attention = tree["models"].pop("attn")
    known = {"n_head": 1, "n_block": 1, "score_act": "relu", "k_act": "none", "q_act": "none"}
    attention["block"] = known | {"transform_kq": True, "temperature": 1.0} | block
    tree["models"]["transformer"] = attention
    return tree


def difference(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> float:
    return max(float(np.abs(first[name] - second[name]).max()) for name in first)


@pytest.mark.parametrize("bare", [False, True])
def test_the_same_pictures_under_both_names(tmp_path: Path, bare: bool) -> None:
    state = official_state(skip=True)
    new = load(tmp_path, {"250000": state}, yaml_tree())
    older = older_names(state)
    old = load(tmp_path, older if bare else {"250000": older}, older_tree())
    assert old.config == new.config
    assert old.provenance["step"] == (None if bare else 250000)
    assert difference(render(old, view()), render(new, view())) <= 1e-5


@pytest.mark.parametrize("older_first", [False, True])
def test_configurations_of_both_ages_are_laid_over_one_another(
    tmp_path: Path, older_first: bool
) -> None:
    """Today's default.yml says relu; the scene's older file says leakyrelu, and the reverse."""
    state = official_state(skip=True)
    older, today = older_tree(), yaml_tree(act="relu", skip=[])
    if older_first:
        older["models"]["transformer"]["embed"]["value"]["skip_layers"] = []
        today = yaml_tree(act="relu", skip=[5])
        assert load(tmp_path, state, older, today).config.negative_slope == 0.0
        return
    config = load(tmp_path, state, today, older).config
    assert config.negative_slope == 0.2
    assert config == load(tmp_path, state, yaml_tree()).config


@pytest.mark.parametrize(
    ("key", "value"),
    [("n_head", 2), ("n_block", 3), ("k_act", "relu"), ("transform_kq", False), ("temperature", 2)],
)
def test_variants_of_older_attention_are_named(tmp_path: Path, key: str, value: object) -> None:
    with pytest.raises(CheckpointError, match=rf"models\.attn\.block\.{key}: expected .*, got"):
        load(tmp_path, official_state(skip=True), older_tree(**{key: value}))


def half_layers(state: State, tree: dict[str, Any]) -> None:
    tree["models"]["transformer"]["embed"]["key"]["half_layers"] = [2]


def second_block(state: State, tree: dict[str, Any]) -> None:
    state["transformer.blocks.1.w_k.weight"] = torch.zeros(WIDTH, WIDTH)


def no_query(state: State, tree: dict[str, Any]) -> None:
    del state["transformer.blocks.0.w_q.weight"]


def both_ages(state: State, tree: dict[str, Any]) -> None:
    state["proximity_attn.attention_layer.w_k.weight"] = torch.zeros(WIDTH, WIDTH)


def layers_of_training(state: State, tree: dict[str, Any]) -> None:
    state["mapping_mlp.0.weight"] = torch.zeros(2)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (half_layers, r"embed\.key\.half_layers: expected \[\], got \[2\]"),
        (second_block, r"unknown tensor transformer\.blocks\.1\.w_k\.weight"),
        (no_query, r"missing tensor proximity_attn\.attention_layer\.w_q\.weight"),
        (both_ages, r"missing tensor proximity_attn\.embed"),
        (layers_of_training, r"unknown tensor mapping_mlp\.0\.weight"),
    ],
)
def test_older_checkpoints_that_are_not_whole(tmp_path: Path, harm, said: str) -> None:
    state, tree = older_names(official_state(skip=True)), older_tree()
    harm(state, tree)
    with pytest.raises(CheckpointError, match=said):
        load(tmp_path, state, tree)


def test_import_from_the_command_line(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"250000": older_names(official_state(skip=True))}, "old.pth")
    Path("old.yml").write_text(yaml.safe_dump(older_tree()))
    assert main(["import", "papr", "old.pth", "--config", "old.yml", "-o", "run"]) == 0
    assert "lego, 50 points, 250,000 steps" in capsys.readouterr().out


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1"])
def test_configurations_in_other_encodings(tmp_path: Path, encoding: str) -> None:
    torch.save(official_state(skip=True), tmp_path / "model.pth")
    text = "# b\xfccher\n" + yaml.safe_dump(yaml_tree())
    (tmp_path / "a.yml").write_text(text, encoding=encoding)
    assert load_official(tmp_path / "model.pth", [tmp_path / "a.yml"]).config.negative_slope == 0.2


@pytest.mark.parametrize("net", ["key", "query"])
def test_a_skip_that_only_the_tensors_show_is_refused(tmp_path: Path, net: str) -> None:
    state = official_state(skip=True)
    inputs = {"key": 117, "query": 39}[net]
    name = f"proximity_attn.embed.embed_{net[0]}.mlp.model.5.weight"
    state[name] = torch.randn(WIDTH, WIDTH + inputs)
    with pytest.raises(CheckpointError, match=f"no skip of the input in the {net} network, got"):
        load(tmp_path, state, yaml_tree())

"""Which methods runs are compared by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.asset.test_lit_gaussians import dark_asset, lit_asset

from pcore.capture.load import load_scene
from pcore.data.scene import Scene
from pcore.errors import InputError
from pcore.evaluation.methods import methods_of
from tiny_scene import write_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write_scene(tmp_path_factory.mktemp("scene") / "box", states=False))


def test_gaussians_are_compared_with_their_shapes_and_their_light(scene: Scene) -> None:
    names = [one.name for one in methods_of([lit_asset()], scene, rays="both", light=None)]
    assert names == ["Gaussians", "Gaussians affine", "Gaussians affine + light"]
    names = [one.name for one in methods_of([lit_asset()], scene, rays="aware", light="baked")]
    assert names == ["Gaussians affine"]
    names = [one.name for one in methods_of([dark_asset()], scene, rays="both", light=None)]
    assert names == ["Gaussians", "Gaussians affine"]
    tuned = replace(lit_asset(), provenance=replace(lit_asset().provenance, stage="finetune"))
    both = [lit_asset(), tuned]
    names = [one.name for one in methods_of(both, scene, rays="aware", light="baked")]
    assert names == ["Gaussians affine", "Gaussians affine + P-CORE"]
    with pytest.raises(InputError, match="pcore light RUN"):
        methods_of([dark_asset()], scene, rays="both", light="still")


def test_runs_in_folders_of_one_name_are_told_apart(scene: Scene, tmp_path: Path) -> None:
    runs = [
        replace(one, record=replace(one.record, path=tmp_path / place / "run"))
        for one, place in ((dark_asset(), "first"), (dark_asset(), "second"))
    ]
    names = [one.name for one in methods_of(runs, scene, rays="aware", light=None)]
    assert names == ["Gaussians affine (first/run)", "Gaussians affine (second/run)"]

"""Files that a plan names: where they are looked for, and what is known of what they hold."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from toys import write_scene

from pcore.cli.sweep_places import placed, with_contents
from pcore.sweep.sweep_trial import Trial


def trial_of(folder: Path, scene: Path, verbs: Any) -> Trial:
    return Trial(
        scene="ball",
        setting="papr",
        seed=0,
        scene_folder=scene,
        folder=folder / "trial",
        verbs=verbs,
        threads=1,
        device="cpu",
    )


def test_files_of_options_are_seen_from_the_plan(tmp_path: Path) -> None:
    for name in ("lean.json", "theirs", "before"):
        (tmp_path / name).touch()
    verbs: Any = {
        "train": {"masks": "auto", "init": "hull", "steps": 3},
        "eval": {"edit": ["lean.json"], "baseline": "before"},
        "compare": {"pictures": ["other=theirs"]},
    }
    (found,) = placed([trial_of(tmp_path, tmp_path, verbs)], tmp_path)
    assert found.verbs == {
        "train": verbs["train"],
        "eval": {"edit": [str(tmp_path / "lean.json")], "baseline": str(tmp_path / "before")},
        "compare": {"pictures": [f"other={tmp_path / 'theirs'}"]},
    }


def test_what_tells_people_about_a_scene_is_no_part_of_it(tmp_path: Path) -> None:
    scene = tmp_path / "ball"
    write_scene(scene)
    trial = trial_of(tmp_path, scene, {"train": {}})
    (before,) = with_contents([trial])
    assert {"scene/transforms_train.json", "scene/train/r_0.png"} <= {*before.inputs}
    for name in ("README.md", "README.txt", "plan.yaml", "report.html"):
        (scene / name).write_text("about the scene")
    (scene / "itself").symlink_to(scene)
    (scene / "train" / "above").symlink_to(scene)
    os.mkfifo(scene / "pipe")
    (after,) = with_contents([trial])
    assert after.inputs == before.inputs
    (scene / "train" / "r_0.png").write_bytes((scene / "train" / "r_1.png").read_bytes())
    (changed,) = with_contents([trial])
    differ = {name for name in before.inputs if before.inputs[name] != changed.inputs[name]}
    assert differ == {"scene/train/r_0.png"}


def test_files_that_an_edit_names_are_inputs_as_well(tmp_path: Path) -> None:
    write_scene(tmp_path / "ball")
    edit, cage = tmp_path / "bent.json", tmp_path / "cages" / "bent.ply"
    cage.parent.mkdir()
    cage.write_text("one")
    named = {"type": "cage", "before": "cages/bent.ply", "after": "x" * 5000}
    edit.write_text(json.dumps({"version": 2, "edits": [named]}))
    trial = trial_of(tmp_path, tmp_path / "ball", {"train": {}, "eval": {"edit": [str(edit)]}})
    (before,) = with_contents([trial])
    cage.write_text("two")
    (after,) = with_contents([trial])
    differ = {name for name in before.inputs if before.inputs[name] != after.inputs[name]}
    assert differ == {str(cage)}


def test_of_a_run_its_weights_are_read(tmp_path: Path) -> None:
    write_scene(tmp_path / "ball")
    run = tmp_path / "before"
    (run / "eval").mkdir(parents=True)
    for name in ("run.json", "model.safetensors", "eval/summary.json"):
        (run / name).write_text("{}")
    trial = trial_of(tmp_path, tmp_path / "ball", {"eval": {"baseline": str(run)}})
    (found,) = with_contents([trial])
    assert [one for one in found.inputs if one.startswith(str(run))] == [f"{run}/model.safetensors"]

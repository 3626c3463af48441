"""Plans: what is refused before anything starts."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pcore.errors import DependencyError, InputError
from pcore.sweep import executors
from pcore.sweep.executors import Machine, check_resources, check_workers
from pcore.sweep.sweep_plan import TrialResources, read_plan
from pcore.sweep.sweep_trial import Trial, TrialResult, attempt, finished_trial, trials_of

GOOD = """
version: 1
scenes: {knight: data/knight, robot: data/robot}
seeds: [0, 3]
settings:
  fast:
    train:
    eval: {state: [all]}
  slow:
    train: {steps: 100}
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def some_trial(folder: Path) -> Trial:
    plan = read_plan(written(folder, GOOD))
    return trials_of(plan, beside=folder, folder=folder / "out")[0]


def test_every_scene_setting_and_seed_is_a_trial(tmp_path: Path) -> None:
    plan = read_plan(written(tmp_path, GOOD))
    trials = trials_of(plan, beside=tmp_path, folder=tmp_path / "out")
    assert [one.name for one in trials][:3] == [
        "knight/fast/seed-0",
        "knight/fast/seed-3",
        "knight/slow/seed-0",
    ]
    assert len(trials) == 8
    assert trials[0].verbs == {"train": {}, "eval": {"state": ["all"]}}
    assert trials[2].verbs == {"train": {"steps": 100}}
    assert trials[0].scene_folder == tmp_path / "data" / "knight"
    assert (trials[0].threads, trials[0].device) == (1, "cpu")


def test_processes_of_a_trial_are_more_cores_and_a_stamp_of_its_own(tmp_path: Path) -> None:
    alone = some_trial(tmp_path)
    text = GOOD + "resources: {cpus: 2, processes: 3, gpus: 3}\n"
    plan = read_plan(written(tmp_path, text))
    (trial, *_) = trials_of(plan, beside=tmp_path, folder=tmp_path / "out")
    assert (trial.processes, trial.threads, trial.device) == (3, 2, "cuda")
    assert plan.resources.cores == 6
    assert trial.stamp[-1] == 3
    assert alone.stamp[-1] == "cpu"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("version: 1", "version: 2"), "'version'"),
        (("seeds: [0, 3]", "seeds: [0, 0]"), "each seed once"),
        (("seeds: [0, 3]", "seeds: []"), "a list of at least 1"),
        (("seeds: [0, 3]", "seeds: [0.5]"), "'seeds.0': expected a whole number"),
        (("version: 1", "version: 1\nworkers: 2"), "'workers' is not a known key"),
        (("seeds: [0, 3]", "seeds: [2026-11-29]"), "put quotes around dates"),
        (("seeds: [0, 3]", "seeds: [0"), "expected YAML"),
        (("robot: data/robot", "all: data/robot"), "mean over scenes"),
        (("robot: data/robot", "Knight: data/robot"), "more than case"),
        (("robot: data/robot", "../x: data/robot"), "'scenes': expected names that can"),
        (("  slow:", "  my setting:"), "'settings': expected names that can be folders"),
        (("  slow:", "  fast:"), "the key 'fast' stands twice"),
        (("    train: {steps: 100}", "    finetune: {}"), "'settings.slow.train' is missing; add"),
        (
            ("    train: {steps: 100}", "    trian: {}"),
            "'settings.slow.train' is missing, and 'settings.slow.trian' is not a known key;",
        ),
        (("    train: {steps: 100}", "    train: 3"), "'settings.slow.train'"),
        (("version: 1", "version: 1\nresources: {cpus: 0}"), "'resources.cpus'"),
        (("version: 1", "version: 1\nresources: {gpus: 2}"), "got 2 for 1; give processes: N and"),
        (("version: 1", "version: 1\nresources: {gpus: 1, processes: 2}"), "got 1 for 2"),
        (("version: 1", "version: 1\nresources: {processes: 0}"), "'resources.processes'"),
        (("seeds: [0, 3]", f"seeds: [{2**63}]"), "'seeds.0'"),
        (("{knight: data/knight, robot: data/robot}", "[knight]"), "expected keys with values {"),
        (("{knight: data/knight, robot: data/robot}", "{}"), "expected keys of at least 1, got {}"),
        (
            (GOOD, ""),
            "expected keys with values in YAML (version, scenes, settings, seeds), got an",
        ),
        ((GOOD, "- knight"), "got one list"),
        (("version: 1", "version: 1\nresources: {memory: 2}"), "'resources.memory' is not a known"),
    ],
)
def test_a_wrong_plan_says_what_is_wrong(
    tmp_path: Path, change: tuple[str, str], said: str
) -> None:
    assert change[0] in GOOD
    with pytest.raises(InputError) as caught:
        read_plan(written(tmp_path, GOOD.replace(*change)))
    assert said in str(caught.value)
    assert "plan.yaml" in str(caught.value)


def test_impossible_resources_are_refused() -> None:
    small = Machine(cpus=2, gpus=0, memory=4e9)
    check_resources(TrialResources(cpus=2, memory_gb=4), [small])
    check_resources(TrialResources(gpus=1), [small, Machine(cpus=8, gpus=1)])
    for wanted in ({"cpus": 3}, {"gpus": 0.5}, {"memory_gb": 4.5}):
        with pytest.raises(InputError, match=r"2 CPUs, 0 GPUs, 4\.0 GB of memory"):
            check_resources(TrialResources(**wanted), [small])
    check_workers(TrialResources(cpus=1), 2, small)
    with pytest.raises(InputError, match="at most 1"):
        check_workers(TrialResources(cpus=2), 2, small)


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    machine = Machine(cpus=2, gpus=0)
    with (
        pytest.raises(DependencyError, match=r"pcore-edit\[cluster\]"),
        executors.on_ray(TrialResources(), address=None, workers=1, machine=machine),
    ):
        pass


def test_an_attempt_is_on_record_until_the_plan_changes(tmp_path: Path) -> None:
    trial = some_trial(tmp_path)
    assert finished_trial(trial) is None
    result = attempt(trial, lambda one: sys.stdout.write(f"{one.name}\n") and None)
    assert result.failed is None
    assert (trial.folder / "output.txt").read_text() == f"{trial.name}\n"
    assert finished_trial(trial) == result
    other = Trial(**{**vars(trial), "verbs": {"train": {"steps": 7}}})
    assert finished_trial(other) is None


def test_an_attempt_that_fails_is_a_result(tmp_path: Path) -> None:
    trial = some_trial(tmp_path)

    def fail(trial: Trial) -> None:
        raise ZeroDivisionError("of somebody's package")

    assert attempt(trial, fail).failed == "ZeroDivisionError: of somebody's package"
    assert "Traceback" in (trial.folder / "output.txt").read_text()
    assert finished_trial(trial) is None
    # Of a trial that was tried before it is not known how long all of it takes.
    assert attempt(trial, lambda one: None) == TrialResult(trial=trial)


def test_a_folder_that_cannot_be_written_is_a_result(tmp_path: Path) -> None:
    trial = some_trial(tmp_path)
    (tmp_path / "out").write_text("a file where the folder should be")
    failed = attempt(trial, lambda one: None).failed
    assert failed is not None
    assert "Not a directory" in failed or "File exists" in failed

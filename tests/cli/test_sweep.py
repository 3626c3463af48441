"""`pcore sweep`: trials are the ordinary commands, go on, fail alone, and end in one table."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file
from toys import write_scene

from pcore.cli import sweep_results
from pcore.cli.main import main
from pcore.cli.sweep_verbs import run_trial
from pcore.sweep import sweep_storage
from pcore.sweep.sweep_storage import fetch
from pcore.sweep.sweep_tables import TABLES
from pcore.sweep.sweep_trial import Trial

PLAN = """
version: 1
scenes: {ball: ball}
seeds: [0, 1]
settings:
  papr:
    train: {model: papr, steps: 3, points: 60}
    finetune: {preset: tiny, steps: 2}
    eval: {state: ["scale:1.5"], rays: plain, protocol: standard}
  more:
    train: {model: papr, steps: 3, points: 80, no_tensorboard: true}
    eval: {state: ["scale:1.5"], rays: plain, protocol: standard}
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    write_scene(tmp_path / "ball")
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


def sweep(plan: Path, *words: str) -> int:
    return main(["sweep", str(plan), "-o", str(plan.parent / "out"), *words])


def rows(path: Path) -> list[dict[str, str]]:
    return [*csv.DictReader(path.read_text(encoding="utf-8").splitlines())]


def test_a_plan_in_turn(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its figures are those of the commands typed by hand; a second time nothing is repeated."""
    assert sweep(plan) == 0
    said = capsys.readouterr().out
    assert re.search(r"4/4 ball/more/seed-1: finished in \d+:\d\d\n", said)
    assert "mean ± standard deviation over 2 seeds" in said
    out, hand = plan.parent / "out", str(plan.parent / "hand")
    scene = str(plan.parent / "ball")
    machine = ["--device", "cpu", "--threads", "1"]
    train = ["--model", "papr", "--steps", "3", "--points", "60", "--seed", "1", *machine]
    assert main(["train", scene, "-o", hand, *train]) == 0
    tune = ["--preset", "tiny", "--steps", "2", "--seed", "1", *machine]
    assert main(["finetune", hand, "-o", hand + "-tuned", *tune]) == 0
    score = ["--state", "scale:1.5", "--rays", "plain", "--protocol", "standard", *machine]
    assert main(["eval", hand + "-tuned", "-o", hand + "-eval", *score]) == 0
    trial = out / "trials" / "ball" / "papr" / "seed-1"
    mine = (trial / "eval" / "images.csv").read_bytes()
    assert mine == (Path(hand + "-eval") / "images.csv").read_bytes()
    _check_tables(out)
    before = {path: path.stat().st_mtime_ns for path in (out / "trials").rglob("*")}
    tables = (out / "sweep.json").read_bytes()
    capsys.readouterr()
    assert sweep(plan) == 0
    assert "4 of 4 trials are finished already" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in (out / "trials").rglob("*")} == before
    assert (out / "sweep.json").read_bytes() == tables
    assert sweep(plan, "--dry-run") == 0
    assert "0 to run, 1 at a time: about 0:00" in capsys.readouterr().out


KILLED = """
import os, signal, sys
from pcore.cli.main import main
from pcore.files.run_folder import RunFolder
save = RunFolder.save_state
RunFolder.save_state = lambda *words: (save(*words), os.kill(os.getpid(), signal.SIGKILL))
main(["sweep", *sys.argv[1:]])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is killed outright there")
def test_a_sweep_that_is_killed_outright_goes_on_to_the_same_bits(plan: Path) -> None:
    """Killed between the state and the model; made again in this process, whose threads differ."""
    plan.write_text(PLAN.partition("    finetune:")[0].replace("seeds: [0, 1]", "seeds: [0]"))
    out = plan.parent / "out"
    command = [sys.executable, "-c", KILLED, str(plan), "-o", str(out)]
    ended = subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
    assert ended.returncode == -signal.SIGKILL
    first = out / "trials" / "ball" / "papr" / "seed-0"
    assert (first / "run" / "state.pt").exists()
    assert not (first / "trial.json").exists()
    assert sweep(plan) == 0
    assert "goes on from step 3" in (first / "output.txt").read_text()
    quiet, scene = plan.parent / "quiet", str(plan.parent / "ball")
    train = ["--model", "papr", "--steps", "3", "--points", "60", "--seed", "0"]
    machine = ["--device", "cpu", "--threads", "1"]
    assert main(["train", scene, "-o", str(quiet), *train, *machine]) == 0
    found, expected = (load_file(run / "model.safetensors") for run in (first / "run", quiet))
    assert {*found} == {*expected}
    assert all(found[key].tobytes() == expected[key].tobytes() for key in found)


def _check_tables(out: Path) -> None:
    scores = rows(out / "results.csv")
    keys = {(one["setting"], one["method"], one["seed"], one["state"]) for one in scores}
    methods = (("papr", "PAPR"), ("papr", "P-CORE"), ("more", "PAPR"))
    states = ("canonical", "scale:1.5")
    assert keys == {(*m, seed, state) for m in methods for seed in "01" for state in states}

    def values(table: list[dict[str, str]], **wanted: str) -> list[float]:
        found = [one for one in table if all(one[key] == wanted[key] for key in wanted)]
        return [float(one["psnr"]) for one in found]

    papr = values(scores, setting="papr", method="PAPR", state="canonical")
    more = values(scores, setting="more", method="PAPR", state="canonical")
    means = rows(out / "means.csv")
    assert values(means, setting="papr", method="PAPR", state="canonical") == pytest.approx(
        [sum(papr) / 2]
    )
    differences = rows(out / "differences.csv")
    assert values(
        differences, setting="more", against_setting="papr", state="canonical"
    ) == pytest.approx([sum(more) / 2 - sum(papr) / 2])
    record: dict[str, Any] = json.loads((out / "sweep.json").read_bytes())
    assert record["status"] == "finished"
    assert len(record["trials"]) == 4


def test_failures_are_listed_and_cost_nobody_else(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The folder of one trial holds somebody's files; once they are away, it alone is run."""
    text = PLAN.replace("seeds: [0, 1]", "seeds: [0]").replace(
        "    finetune: {preset: tiny, steps: 2}\n", ""
    )
    plan.write_text(text, encoding="utf-8")
    blocked = plan.parent / "out" / "trials" / "ball" / "papr" / "seed-0" / "run"
    (plan.parent / "out").mkdir()
    (plan.parent / "out" / "sweep.json").write_text("{}")
    blocked.mkdir(parents=True)
    (blocked / "notes.txt").write_text("of somebody")
    assert sweep(plan) == 2
    told = capsys.readouterr()
    assert "1/2 ball/papr/seed-0: failed: " in told.out
    assert "holds other files (notes.txt)" in told.out
    assert "1 of 2 trials failed, the others are finished: ball/papr/seed-0" in told.err
    assert {one["setting"] for one in rows(plan.parent / "out" / "results.csv")} == {"more"}
    (blocked / "notes.txt").unlink()
    assert sweep(plan) == 0
    told = capsys.readouterr()
    assert "1 of 2 trials are finished already" in told.out
    assert "ball/more/seed-0: finished" not in told.out
    settings = [one["setting"] for one in rows(plan.parent / "out" / "results.csv")]
    assert {*settings} == {"papr", "more"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("ball: ball", "ball: nowhere"), "nowhere"),
        (("points: 60", "pionts: 60"), "setting 'papr', train: Unrecognized options: --pionts=60;"),
        (("steps: 3", "steps: many"), "setting 'papr', train: "),
        (("points: 60", "seed: 60"), "one that the sweep gives to each"),
        (("points: 60", "-o: x"), "one that the sweep gives to each"),
        (("points: 60", "points:"), "'points': expected a value or a list, got None"),
        (("preset: tiny, steps", "presets: tiny, steps"), "setting 'papr', finetune: "),
        (("scale:1.5", "twist90"), "twist90"),
        (("steps: 3", "masks: nowhere"), "train: 'masks': expected a file or folder, seen from"),
        (
            ("rays: plain", "edit: [nope.json]"),
            "eval: 'edit': expected a file or folder, seen from",
        ),
        (("steps: 3", "steps: 0"), "train: 'steps': expected a whole number of at least 1, got 0"),
        (("steps: 3", "steps: 3, minutes: 2"), "train: --minutes 2 chooses steps and points"),
        (("steps: 3", "steps: 3, flat: true"), "train: --flat: expected options of PAPR"),
        (
            ("  more:", "    compare: {methods: [nerf]}\n  more:"),
            "setting 'papr', compare: --methods: expected some of",
        ),
        (("rays: plain", "edit: [odd.json]"), """odd.json: edit 1: key "type": expected one of"""),
        (("rays: plain", "against: end"), "setting 'papr', eval: --against: expected --edit FILE"),
        (("rays: plain", "edit: [still.json], against: end"), "no state 'end'"),
        (
            ("version: 1", "version: 1\nresources: {processes: 2}"),
            "setting 'papr', train: expected at least one patch or photo of a step for each of 2",
        ),
        (("version: 1", "version: 1\nresources: {cpus: 4096}"), "expected a machine with 4096"),
        (("version: 1", "version: 1\nresources: {memory_gb: 1000000}"), "GB of memory for each"),
    ],
)
def test_mistakes_are_said_before_anything_starts(
    plan: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], said: str
) -> None:
    assert change[0] in PLAN
    plan.write_text(PLAN.replace(*change), encoding="utf-8")
    for name, edits in (("odd", '{"type": "twst"}'), ("still", "")):
        text = f'{{"version": 2, "edits": [{edits}]}}'
        (plan.parent / f"{name}.json").write_text(text, encoding="utf-8")
    assert sweep(plan) == 2
    assert said in capsys.readouterr().err
    assert not (plan.parent / "out").exists()


def test_a_plan_whose_training_fails_is_not_forecast(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where a photo is damaged, which is seen when it is opened."""
    for picture in (plan.parent / "ball" / "train").glob("*.png"):
        picture.write_bytes(picture.read_bytes()[:-40])
    assert sweep(plan, "--dry-run") == 2
    told = capsys.readouterr().err
    assert "plan: setting 'papr', train fails at once: " in told
    assert "r_0.png" in told


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not torch.distributed.is_available(), reason="torch without distributed")
def test_processes_share_a_trial(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two of them train what one trains with as many patches; a failure is the command's own."""
    text = PLAN.partition("    finetune:")[0].replace("seeds: [0, 1]", "seeds: [0]")
    text = text.replace("steps: 3", "steps: 3, patches: 2")
    plan.write_text(text + "resources: {processes: 2}\n", encoding="utf-8")
    assert sweep(plan, "--dry-run") == 0
    assert "--nproc-per-node 2 --no-python pcore train" in capsys.readouterr().out
    assert sweep(plan) == 0
    run, alone = plan.parent / "out/trials/ball/papr/seed-0/run", plan.parent / "alone"
    train = ["train", str(plan.parent / "ball"), "-o", str(alone), "--model", "papr"]
    train += ["--steps", "3", "--points", "60", "--patches", "2"]
    assert main([*train, "--device", "cpu", "--threads", "1"]) == 0
    found, expected = (load_file(one / "model.safetensors") for one in (run, alone))
    assert {*found} == {*expected}
    for key, value in expected.items():
        np.testing.assert_allclose(found[key], value, rtol=1e-4, atol=1e-6)
    capsys.readouterr()
    (run / "notes.txt").write_text("of somebody")
    for name in ("run.json", "model.safetensors", "state.pt", "../trial.json"):
        (run / name).unlink()
    assert sweep(plan) == 2
    told = capsys.readouterr()
    assert "its processes ended with code 1: " in told.out
    assert "holds other files" in told.out


def test_tables_are_there_before_the_last_trial_has_ended(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped in its second trial, a sweep has the scores of the first one."""
    first, _, second = PLAN.partition("  papr:")
    plan.write_text(first + second[second.index("  more:") :], encoding="utf-8")

    def stopped(trial: Trial) -> None:
        if trial.seed == 1:
            raise KeyboardInterrupt
        run_trial(trial)

    monkeypatch.setattr(sweep_results, "run_trial", stopped)
    assert sweep(plan) == 130
    out = plan.parent / "out"
    assert {row["seed"] for row in rows(out / "results.csv")} == {"0"}
    assert json.loads((out / "sweep.json").read_text())["status"] == "not finished"
    monkeypatch.undo()
    assert sweep(plan) == 0
    assert {row["seed"] for row in rows(out / "results.csv")} == {"0", "1"}
    assert json.loads((out / "sweep.json").read_text())["status"] == "finished"


def test_a_sweep_that_is_stopped_at_once_goes_on(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder, in which there is no more than a lock, is its own."""

    def stopped(trial: Trial) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep_results, "fetch_records", stopped)
    assert [sweep(plan), sweep(plan)] == [130, 130]
    assert json.loads((plan.parent / "out" / "sweep.json").read_text())["status"] == "not finished"


def test_tables_that_cannot_be_written_for_a_while_end_no_trial(
    plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a network drive that hangs after the first of two trials."""
    first, _, second = PLAN.partition("  papr:")
    plan.write_text(first + second[second.index("  more:") :], encoding="utf-8")
    write, calls = sweep_results.write_sweep, [0]

    def hangs(folder: Path, results: Any, *words: Any, **more: Any) -> None:
        calls[0] += 1
        if len(results) == 1:
            raise OSError(116, "Stale file handle")
        write(folder, results, *words, **more)

    monkeypatch.setattr(sweep_results, "write_sweep", hangs)
    assert sweep(plan) == 0
    assert calls == [5]
    assert {row["seed"] for row in rows(plan.parent / "out" / "results.csv")} == {"0", "1"}


def test_what_a_machine_lacks_is_told_once() -> None:
    lacks = "no LPIPS with vgg: no weights; see there"
    notes = [f"a/b/seed-0: {lacks}", "a/b/seed-0: nerf failed: x", f"a/b/seed-1: {lacks}"]
    assert sweep_results._once(notes) == [lacks, "a/b/seed-0: nerf failed: x"]


def test_every_scene_that_cannot_be_used_is_named(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before anything starts, so that a night is not lost for each of them."""
    write_scene(plan.parent / "torn")
    (plan.parent / "torn" / "transforms_train.json").write_text("{")
    scenes = "scenes: {ball: ball, torn: torn, gone: not here}"
    plan.write_text(PLAN.replace("scenes: {ball: ball}", scenes), encoding="utf-8")
    assert sweep(plan) == 2
    told = capsys.readouterr().err
    assert "plan: 2 scenes cannot be used:" in told
    assert "torn/transforms_train.json" in told
    assert "not here" in told
    assert not (plan.parent / "out").exists()


def test_files_that_change_between_two_commands_are_named(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Tables of one name hold figures of one scene and of one edit, also in a storage."""
    first, _, second = PLAN.partition("  papr:")
    more = second[second.index("  more:") :].replace("state: [", "edit: [bend.json], state: [")
    plan.write_text(first + more, encoding="utf-8")
    edit, ball = plan.parent / "bend.json", plan.parent / "ball"
    twist = '{"version": 2, "edits": [{"type": "twist", "axis": "z", "angle_deg": 5}]}'
    edit.write_text(twist, encoding="utf-8")
    url = f"memory://{plan.parent}/sweep"
    assert sweep(plan, "--storage", url) == 0
    (ball / ".DS_Store").write_text("of a file browser")
    shutil.copytree(plan.parent / "out/trials/ball/more/seed-0/run", ball / "runs")
    assert sweep(plan, "--storage", url) == 0  # What pcore writes there is no part of the scene.

    edit.write_text(twist.replace("5", "6"), encoding="utf-8")
    for words in (("--storage", url), ("--storage", url, "--dry-run"), ()):
        assert sweep(plan, *words) == 2
        told = " ".join(capsys.readouterr().err.split())
        assert "trial ball/more/seed-0: expected the files that it began with, got" in told
        assert f"{edit}; give what has changed another name" in told
    edit.write_text(twist, encoding="utf-8")
    (ball / "train" / "r_3.png").write_bytes((ball / "train" / "r_2.png").read_bytes())
    (ball / "train" / "r_99.png").write_bytes(b"")
    assert sweep(plan) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "got others: scene/train/r_3.png and 1 more;" in told
    (ball / "train" / "r_99.png").unlink()
    plan.write_text(plan.read_text().replace("{ball: ball}", "{other: ball}"), encoding="utf-8")
    assert sweep(plan) == 0


def test_what_a_trial_failed_of_may_be_mended(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, _, second = PLAN.partition("  papr:")
    plan.write_text(first + second[second.index("  more:") :], encoding="utf-8")
    photo = plan.parent / "ball" / "train" / "r_3.png"
    whole = photo.read_bytes()
    photo.write_bytes(whole[: len(whole) // 2])
    assert sweep(plan) == 2
    assert "2 of 2 trials failed" in capsys.readouterr().err
    photo.write_bytes(whole)
    assert sweep(plan) == 0


def test_a_folder_of_somebody_else_is_left_alone(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (plan.parent / "out").mkdir()
    (plan.parent / "out" / "thesis.tex").write_text("of somebody")
    assert sweep(plan) == 2
    assert "thesis.tex" in capsys.readouterr().err
    assert sweep(plan, "--workers", "9999") == 2
    assert "expected at most" in capsys.readouterr().err
    assert sweep(plan, "--workers", "1", "--address", "nowhere:1") == 2
    assert "no number with --address" in capsys.readouterr().err


def test_a_storage_brings_trials_to_another_machine(
    plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second machine, whose folder is empty, repeats nothing and has the same tables."""
    url = f"memory://{plan.parent}/sweep"
    assert sweep(plan, "--storage", url) == 0
    out, other = plan.parent / "out", plan.parent / "other"
    capsys.readouterr()
    assert main(["sweep", str(plan), "-o", str(other), "--storage", url, "--dry-run"]) == 0
    assert "0 to run, 1 at a time: about 0:00" in capsys.readouterr().out
    assert not other.exists()
    first = main(["sweep", str(plan), "-o", str(other), "--storage", url])
    assert first == 0
    assert "4 of 4 trials are finished already" in capsys.readouterr().out
    for name in TABLES:
        assert (other / name).read_bytes() == (out / name).read_bytes()
    trial = Path("trials/ball/papr/seed-1")
    assert not (other / trial / "run" / "model.safetensors").exists()
    fetch(f"{url}/{trial}", other / trial)
    weights = trial / "run" / "model.safetensors"
    assert (other / weights).read_bytes() == (out / weights).read_bytes()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("nothing://here", "expected a place that can be written, got: Protocol not known"),
        ("file:///proc/nowhere", "expected a place that can be written"),
    ],
)
def test_a_storage_that_cannot_be_used_is_said_first(
    plan: Path, capsys: pytest.CaptureFixture[str], url: str, said: str
) -> None:
    assert sweep(plan, "--storage", url) == 2
    assert said in capsys.readouterr().err
    assert not (plan.parent / "out").exists()


def test_a_full_disk_is_said_first(
    plan: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=2_000_000))
    out, store = plan.parent / "out", plan.parent / "store"
    for words in ([], ["--storage", store.as_uri()]):
        assert sweep(plan, *words) == 2
        assert "16 MB free, got 2 MB" in capsys.readouterr().err
        assert not out.exists()


def test_a_storage_that_fails_later_is_one_message(
    plan: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(url: str) -> None:
        raise OSError(28, "No space left on device")

    url = f"memory://{plan.parent}/sweep"
    monkeypatch.setattr(sweep_storage, "opened", full)
    monkeypatch.setattr(sweep_results, "check_storage", lambda url: None)
    assert sweep(plan, "--storage", url) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"Error: storage {url}")
    assert "No space left on device; what is complete there is undamaged" in told


def test_no_workers_at_all_are_refused(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--dry-run"]):
        assert sweep(plan, "--workers", "0", *words) == 2
        assert "--workers: expected a whole number of at least 1, got 0" in capsys.readouterr().err
    assert not (plan.parent / "out").exists()

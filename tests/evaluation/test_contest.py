"""Comparisons: nothing is done twice, one failure stops nothing, seeds become one row."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors import SafetensorError
from tests.asset.test_lit_gaussians import lit_asset

import tiny_scene
from pcore.asset.asset import Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.asset.saving import asset_of
from pcore.errors import EditError
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.contest import Contest, Contestant, Cost, Entry, Outcome
from pcore.evaluation.contest_tables import contest_csv, lines_of, quality_rows
from pcore.evaluation.contestants import RULES, Given, given_entries, rule_entries
from pcore.evaluation.equal_time import as_begun
from pcore.evaluation.motion_method import motion_entries
from pcore.evaluation.rival_entries import BOUND, VOXELS, Workshop
from pcore.evaluation.states import SceneStates, State, open_states
from pcore.files.run_record import RunRecord
from pcore.model.papr import Papr
from pcore.rivals.motion_stages import MotionConfig
from pcore.rivals.voxel_fit import VoxelConfig
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from small_training import pretrain_config


@pytest.fixture(scope="module")
def states(tmp_path_factory: pytest.TempPathFactory) -> SceneStates:
    return open_states(tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box"))


def perfect() -> AssetMethod:
    asset = asset_of(Papr(tiny_scene.CONFIG), tiny_scene.corner_cloud())
    return AssetMethod(name="true", asset=asset, rays="plain", take=tiny_scene.draw_box)


class Folds(AssetMethod):
    """Cannot follow one state."""

    def pose(self, state: State):
        if state.name == "walk":
            raise EditError("state walk: folds at 3 points")
        return super().pose(state)


def entry(make: Callable[[], Contestant], *, name: str = "true", seed: int = 0) -> Entry:
    return Entry(name=name, setting="given", seed=seed, stamp="a", make=make)


def counted() -> tuple[list[int], Callable[[], Contestant]]:
    calls: list[int] = []

    def make() -> Contestant:
        calls.append(1)
        return Contestant(method=perfect(), cost=Cost(seconds=2.0, primitives=8))

    return calls, make


def test_what_is_on_the_disk_is_not_done_again(states: SceneStates, tmp_path: Path) -> None:
    calls, make = counted()
    contest = Contest(folder=tmp_path, states=states.select(["all"]), stamp="x")
    first = contest.run([entry(make)])
    again = contest.run([entry(make)])
    assert len(calls) == 1
    assert [replace(one, rows=()) for one in again] == [replace(one, rows=()) for one in first]
    assert [one.rows for one in again] == [one.rows for one in first]
    # Another scene or another training: done again.
    replace(contest, stamp="y").run([entry(make)])
    replace(contest, stamp="y").run([replace(entry(make), stamp="b")])
    assert len(calls) == 3


def test_names_that_differ_in_other_than_letters_have_rows_of_their_own(
    states: SceneStates, tmp_path: Path
) -> None:
    calls, make = counted()
    entries = [entry(make, name=name) for name in ("true (run.1)", "true (run_1)", "True (run_1)")]
    entries = [replace(one, stamp=one.name) for one in entries]
    contest = Contest(folder=tmp_path, states=states.select([]), stamp="x")
    contest.run(entries)
    assert [one.name for one in contest.run(entries)] == [one.name for one in entries]
    assert len(calls) == len(entries)
    assert len({path.parent.name.casefold() for path in tmp_path.rglob("*.json")}) == len(entries)


def test_the_first_picture_is_taken_once_more_before_any_is_timed(
    states: SceneStates, tmp_path: Path
) -> None:
    calls: list[int] = []

    def draw(asset: Asset, posed, camera):
        calls.append(1)
        if len(calls) == 1:  # Compiles its kernels.
            busy_until = time.process_time() + 0.5
            while time.process_time() < busy_until:
                pass
        return tiny_scene.draw_box(asset, posed, camera)

    contest = Contest(folder=tmp_path, states=states.select([]), stamp="x")
    made = entry(lambda: Contestant(method=replace(perfect(), take=draw)))
    (found,) = contest.run([made])
    assert found.milliseconds is not None
    assert found.milliseconds < 400
    assert len(calls) == 1 + len(found.rows)


def test_what_was_killed_goes_on(states: SceneStates, tmp_path: Path) -> None:
    _, make = counted()
    chosen = states.select(["all"])

    def kill(outcome: Outcome) -> None:
        if outcome.state == "grown":
            raise KeyboardInterrupt

    contest = Contest(folder=tmp_path, states=chosen, stamp="x")
    with pytest.raises(KeyboardInterrupt):
        contest.run([entry(make)], kill)
    drawn: list[str] = []

    def watched() -> Contestant:
        made = make()
        method = made.method

        class Watched(AssetMethod):
            def pose(self, state: State):
                drawn.append(state.name)
                return super().pose(state)

        assert isinstance(method, AssetMethod)
        return replace(made, method=Watched(**vars(method)))

    assert len(contest.run([entry(watched)])) == 3
    assert drawn == ["walk"]


@pytest.mark.parametrize("kind", [RuntimeError, SafetensorError, KeyError])
def test_one_failure_stops_nothing(
    states: SceneStates, tmp_path: Path, kind: type[Exception]
) -> None:
    def broken() -> Contestant:
        raise kind("needs a GPU with nvcc")

    folds = Folds(**{**vars(perfect()), "name": "folds"})
    entries = [
        entry(broken, name="broken"),
        entry(lambda: Contestant(method=folds), name="folds"),
        entry(counted()[1]),
    ]
    contest = Contest(folder=tmp_path, states=states.select(["all"]), stamp="x")
    lines = lines_of(contest.run(entries), "standard")
    why = f"{kind.__name__}: {kind('needs a GPU with nvcc')}"
    assert lines[0].failed == dict.fromkeys(["canonical", "grown", "walk"], why)
    assert lines[1].failed == {"walk": "state walk: folds at 3 points"}
    assert lines[2].failed == {}
    rows = quality_rows(lines, ["grown", "walk"], "foreground_psnr")
    assert [values for _, values in rows] == [("failed",) * 2, ("∞", "failed"), ("∞", "∞")]
    assert "needs a GPU with nvcc" in contest_csv(lines).decode()
    # Failures are tried again.
    calls, make = counted()
    contest.run([entry(make, name="broken")])
    assert calls == [1]


def test_seeds_are_one_row_with_a_spread(states: SceneStates, tmp_path: Path) -> None:
    def off(amount: float) -> Callable[[], Contestant]:
        def draw(asset: Asset, posed, camera):
            seen = tiny_scene.draw_box(asset, posed, camera)
            return replace(seen, rgb=seen.rgb * (1 - amount))

        return lambda: Contestant(method=replace(perfect(), take=draw))

    contest = Contest(folder=tmp_path, states=states.select([]), stamp="x")
    outcomes = contest.run([entry(off(0.1), seed=0), entry(off(0.2), seed=1)])
    (line,) = lines_of(outcomes, "standard")
    cell = line.cells["canonical"]["psnr"]
    assert line.seeds == 2
    assert cell.value is not None
    assert cell.spread is not None
    # A factor of two in the error, of 8 bits, is about 6.02 dB; the deviation of two figures is
    # that divided by sqrt 2.
    assert cell.spread == pytest.approx(6.02 / 2**0.5, abs=0.2)
    ((keys, (text,)),) = quality_rows([line], ["canonical"], "psnr")
    assert keys == ("true", "as given, 2 seeds")
    assert "±" in text


def test_every_rule_draws_gaussians(states: SceneStates, tmp_path: Path) -> None:
    found = rule_entries(
        "given", 0, "x", [*RULES], lambda: (lit_asset(), None), states.scene, suffix=" (x)"
    )
    assert [one.name for one in found] == [f"{name} (x)" for name in RULES.values()]
    outcomes = Contest(folder=tmp_path, states=states.select(["grown"]), stamp="x").run(found)
    assert [one.failed for one in outcomes] == [None] * 2 * len(RULES)
    psnr = {one.name: one.rows[0].scores["psnr"] for one in outcomes if one.state == "canonical"}
    assert len({*psnr.values()}) == 1


def test_a_run_of_flat_gaussians_is_drawn_by_the_rules_for_them(states: SceneStates) -> None:
    asset = lit_asset()
    assert isinstance(asset.content, GaussianContent)
    flat = replace(asset.content, footprint=replace(asset.content.footprint, flat=True))

    def names(*assets: Asset) -> list[str]:
        runs = [Given(asset=one, stamp=str(number)) for number, one in enumerate(assets)]
        wanted = ["3dgs-affine", "2dgs-affine", "2dgs-light"]
        return [one.name for one in given_entries(runs, states.scene, wanted)]

    discs = ["2DGS (ours), affine tangents", "2DGS (ours), affine + light"]
    assert names(replace(asset, content=flat)) == discs
    solid = "3DGS (ours), local affine covariances"
    assert names(asset, replace(asset, content=flat)) == [solid, *discs]


def test_runs_that_differ_in_their_seed_are_one_method(states: SceneStates) -> None:
    asset = perfect().asset

    def given(seed: int, points: int = 8) -> Given:
        config = {"pretrain": {"seed": seed, "points": points}}
        record = replace(asset.record, config=config, path=Path(f"run-{seed}-{points}"))
        return Given(asset=replace(asset, record=record), stamp=str(seed))

    def names(*runs: Given) -> list[tuple[str, int]]:
        return [(e.name, e.seed) for e in given_entries(runs, states.scene, ["papr"])]

    assert names(given(0), given(1)) == [("PAPR", 0), ("PAPR", 1)]
    assert names(given(0), given(1, 9)) == [("PAPR (run-0-8)", 0), ("PAPR (run-1-9)", 1)]


def test_runs_in_folders_of_one_name_are_rows_of_their_own(states: SceneStates) -> None:
    asset = perfect().asset
    places = [Path("/of/a/run"), Path("/of/b/run"), Path("/run"), Path("/other")]
    records = [
        replace(asset.record, config={"pretrain": {"points": number}}, path=path)
        for number, path in enumerate(places)
    ]
    runs = [Given(asset=replace(asset, record=one), stamp=str(one.path)) for one in records]
    found = [entry.name for entry in given_entries(runs, states.scene, ["papr"])]
    assert found == ["PAPR (a/run)", "PAPR (b/run)", "PAPR (/run)", "PAPR (other)"]
    learned = motion_entries(runs[:2], states, Path(), MotionConfig())
    assert len({one.name for one in learned}) == 4
    assert [one.name.endswith("(a/run)") for one in learned] == [True, True, False, False]


def test_rivals_are_trained_once_and_kept(states: SceneStates, tmp_path: Path) -> None:
    shop = Workshop(
        folder=tmp_path / "trained",
        scene=states.scene,
        config=GaussianConfig(
            steps=60, points=150, degree=1, density=DensityConfig(limit=200), validate_every=60
        ),
        points=pretrain_config(),
        primitives=120,
        seconds=0.5,
    )
    contest = Contest(folder=tmp_path, states=states.select(["grown"]), stamp="x")
    entries = shop.entries(["3dgs-affine", "mani-gs"], ["primitives"], [0])
    outcomes = contest.run(entries)
    assert {one.name for one in outcomes} == {RULES["3dgs-affine"], BOUND}
    assert [one.failed for one in outcomes] == [None] * 4
    free, bound = outcomes[0].cost, outcomes[2].cost
    assert free.primitives is not None
    assert free.primitives <= 120
    assert bound.seconds is not None
    assert free.seconds is not None
    assert bound.seconds > free.seconds  # Its first stage is the free one.
    before = {one: one.stat().st_mtime_ns for one in (tmp_path / "trained").glob("*.safetensors")}
    again = replace(contest, stamp="y").run(shop.entries(["mani-gs"], ["primitives"], [0]))
    assert {one: one.stat().st_mtime_ns for one in before} == before
    assert again[0].rows == outcomes[2].rows
    assert again[0].cost == bound


def test_papr_is_trained_for_its_time_and_goes_on_as_it_began(
    states: SceneStates, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shop = Workshop(
        folder=tmp_path / "trained",
        scene=states.scene,
        config=GaussianConfig(),
        points=pretrain_config(),
        primitives=120,
        seconds=0.2,
    )
    for name in ("_LEAST", "_TIMED"):
        monkeypatch.setattr(f"pcore.evaluation.equal_time.{name}", 3)
    assert not shop.entries(["papr-time"], ["primitives"], [0])
    contest = Contest(folder=tmp_path, states=states.select(["grown"]), stamp="x")
    found = contest.run(shop.entries(["papr-time"], ["time"], [1]))
    assert [one.failed for one in found[:4]] == [None] * 4
    assert "expected a light" in str(found[4].failed)  # Of a box that was not learned.
    assert [one.name for one in found[::2]] == ["PAPR", "aware", "aware + light"]
    record = RunRecord.read(tmp_path / "trained" / "points-time-0.2-1")
    asked = record.config["pretrain"]
    assert asked["seed"] == 1
    assert record.seconds is not None
    assert 0 < record.seconds < 10
    again = as_begun(pretrain_config(), tmp_path / "trained" / "points-time-0.2-1", "pretrain")
    assert (again.steps, again.save_every) == (asked["steps"], asked["save_every"])


@pytest.mark.slow
def test_a_voxel_field_is_trained_for_its_time(states: SceneStates, tmp_path: Path) -> None:
    shop = Workshop(
        folder=tmp_path / "trained",
        scene=states.scene,
        config=GaussianConfig(steps=60, points=150, degree=0, density=DensityConfig(limit=200)),
        points=pretrain_config(),
        primitives=120,
        seconds=2.0,
        voxels=VoxelConfig(cells=10, steps=150, rays=300),
    )
    assert not shop.entries(["voxels"], ["primitives"], [0])
    contest = Contest(folder=tmp_path, states=states.select(["grown"]), stamp="x")
    for one in contest.run(shop.entries(["voxels"], ["time"], [0])):
        assert one.name == VOXELS
        assert one.failed is None
        assert one.cost.primitives is not None

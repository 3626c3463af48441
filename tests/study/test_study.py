"""`pcore study`: what is asked, what the page gives away, and what answers say."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.stats import beta

from pcore.cli.main import main
from pcore.errors import InputError
from pcore.study.answers import read_answers, read_key
from pcore.study.trials import plan_study
from pcore.study.win_rates import ALL, agreement, win_rates

METHODS = ("ours", "papr", "sc-gs")
ITEMS = ("objects/cup", "objects/spoon", "editor/chair")


@pytest.fixture
def pictures(tmp_path: Path) -> dict[str, Path]:
    """Three items of three methods; every picture another grey on white."""
    folders = {name: tmp_path / name for name in METHODS}
    for number, folder in enumerate(folders.values()):
        for index, item in enumerate(ITEMS):
            path = folder / f"{item}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            pixels = np.full((40, 60, 3), 255, np.uint8)
            pixels[8:32, 10:50] = 40 * number + 10 * index
            Image.fromarray(pixels).save(path)
    return folders


@pytest.fixture
def made(pictures: dict[str, Path], tmp_path: Path) -> Path:
    words = [f"{name}={folder}" for name, folder in pictures.items()]
    assert main(["study", "make", "--pairs", *words, "-o", str(tmp_path / "study")]) == 0
    return tmp_path / "study"


def answers(made: Path, person: str, choose: Callable[[dict[str, Any]], int]) -> Path:
    """Write what the page would for somebody who chooses the picture of that number."""
    key = json.loads((made / "key.json").read_text())
    given = [
        {
            "trial": number,
            "left": trial["keys"][1],
            "right": trial["keys"][0],
            "chosen": trial["keys"][choose(trial)],
            "seconds": 1.5,
        }
        for number, trial in enumerate(key["trials"])
    ]
    path = made.parent / f"answers-{person}.json"
    record = {
        "format": "pcore-study-answers",
        "version": 1,
        "study": key["study"],
        "person": person,
        "started": "2026-11-29T10:00:00Z",
        "asked": len(given),
        "answers": given,
    }
    path.write_text(json.dumps(record))
    return path


def first(trial: dict[str, Any]) -> int:
    return 0


def all_but_chairs(trial: dict[str, Any]) -> int:
    return int(trial["item"] == "editor/chair" and not trial["catch"])


def careless(trial: dict[str, Any]) -> int:
    return int(trial["catch"])


def test_the_first_method_meets_each_of_the_others(pictures: dict[str, Path]) -> None:
    study = plan_study(pictures, catch=2)
    asked = [(one.item, one.group, one.first, one.second) for one in study.trials if not one.catch]
    assert len(asked) == len(ITEMS) * 2
    assert ("objects/cup", "objects", "ours", "papr") in asked
    assert {pair[2] for pair in asked} == {"ours"}
    assert len(plan_study(pictures, every_pair=True, catch=0).trials) == len(ITEMS) * 3
    assert len({one.key for one in study.shown.values()}) == 9 + 2


def test_a_catch_trial_shows_holes_where_the_object_is(pictures: dict[str, Path]) -> None:
    study = plan_study(pictures, catch=1)
    (catch,) = (one for one in study.trials if one.catch)
    whole, torn = (
        np.asarray(Image.open(io.BytesIO(study.shown[key].content)).convert("RGB"))
        for key in catch.keys
    )
    changed = (whole != torn).any(axis=-1)
    assert 0.05 < changed[8:32, 10:50].mean() < 0.9
    assert (torn[changed] == 255).all()


def test_the_page_does_not_say_whose_a_picture_is(made: Path) -> None:
    page = (made / "study.html").read_text()
    key = json.loads((made / "key.json").read_text())
    for word in (*METHODS, *ITEMS, "holes torn"):
        assert word not in page
    text = page.split('type="application/json">')[1].split("</script>")[0]
    orders = [
        one["keys"] == list(known["keys"])
        for one, known in zip(json.loads(text)["trials"], key["trials"], strict=True)
    ]
    assert 0 < sum(orders) < len(orders)
    assert set(json.loads(text)["shown"]) == {k for one in key["trials"] for k in one["keys"]}


def test_answers_become_win_rates(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [answers(made, "a", first), answers(made, "b", all_but_chairs)]
    key = read_key(made / "key.json")
    people = read_answers(paths, key, caught=0.75).people
    rates = {(one.second, one.group): one for one in win_rates(people, key)}
    assert set(rates) == {(m, g) for m in ("papr", "sc-gs") for g in ("objects", "editor", ALL)}
    found = rates["papr", ALL]
    assert (found.wins, found.choices) == (5, 6)
    # Clopper and Pearson's interval by its definition.
    assert found.low == pytest.approx(beta.ppf(0.025, 5, 2))
    assert found.high == pytest.approx(beta.ppf(0.975, 6, 1))
    assert found.p == pytest.approx(2 * (6 + 1) / 2**6)
    both = agreement(people, key)
    assert both is not None
    assert (both.pairs, both.observed) == (6, pytest.approx(4 / 6))
    rate = 10 / 12
    chance = rate**2 + (1 - rate) ** 2
    assert both.kappa == pytest.approx((4 / 6 - chance) / (1 - chance))
    assert main(["study", "read", str(made / "key.json"), *map(str, paths)]) == 0
    said = capsys.readouterr().out
    assert "2 people" in said
    assert "5/6" in said
    assert "165/178" in said


def test_who_did_not_look_is_not_counted(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = answers(made, "a", first), answers(made, "b", careless)
    assert main(["study", "read", str(made / "key.json"), str(good), str(bad)]) == 0
    said = capsys.readouterr().out
    assert "1 person" in said
    assert "person b: 0 of 3 catch trials right, not counted" in said
    assert main(["study", "read", str(made / "key.json"), str(bad)]) == 2
    assert "expected answers of at least one person" in capsys.readouterr().err


def test_who_answered_nothing_or_no_catch_trial_is_not_counted(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [answers(made, person, first) for person in "abc"]
    for path, kept in zip(paths[1:], (0, 6), strict=True):
        record = json.loads(path.read_text())
        record["answers"] = record["answers"][:kept]
        path.write_text(json.dumps(record))
    assert main(["study", "read", str(made / "key.json"), *map(str, paths)]) == 0
    said = capsys.readouterr().out
    assert "1 person" in said
    assert "person b: no answers, not counted" in said
    assert "person c: none of the catch trials answered, not counted" in said


def test_catch_trials_that_could_not_be_made_are_told(
    pictures: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"{name}={folder}" for name, folder in pictures.items()]
    out = ["-o", str(tmp_path / "five"), "--catch", "5"]
    assert main(["study", "make", "--pairs", *words, *out]) == 0
    assert "3 of 5 catch trials: each needs a picture of its own" in capsys.readouterr().out


def test_copies_count_once_and_holes_are_told(
    made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = answers(made, "a", first)
    record = json.loads(path.read_text())
    record["answers"] = record["answers"][:-1]
    path.write_text(json.dumps(record))
    copy = path.with_name("copy.json")
    copy.write_text(path.read_text())
    assert main(["study", "read", str(made / "key.json"), str(path), str(copy)]) == 0
    said = capsys.readouterr().out
    assert "copy.json: a copy of a file that is counted already" in said
    assert "8 of 9 pairs were answered" in said
    record["answers"] = record["answers"][:-1]
    copy.write_text(json.dumps(record))
    with pytest.raises(InputError, match="a second one of person a with other answers"):
        read_answers([path, copy], read_key(made / "key.json"), caught=0.5)


def change(record: dict[str, Any], place: str, value: object) -> None:
    record["answers"][0][place] = value


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda r: r.update(study="other"), "got those of other; give the key.json"),
        (lambda r: r.update(format="x"), "expected format 'pcore-study-answers'"),
        (lambda r: r.pop("person"), "'person' is missing; add it"),
        (lambda r: r["answers"].append(r["answers"][0]), "each pair once, got number 0 more"),
        (lambda r: change(r, "trial", 99), "pictures of the study's pair 99"),
        (lambda r: change(r, "chosen", "?"), r"chosen \?; was the file changed"),
        (lambda r: change(r, "seconds", "long"), "'answers.0.seconds': expected a number"),
        (
            lambda r: change(r, "seconds", float("nan")),
            "'answers.0.seconds': expected a finite number",
        ),
        (lambda r: change(r, "seconds", -1.0), "'answers.0.seconds': .*greater than or equal to 0"),
        (lambda r: r.update(asked=1), "expected at most the 1 pairs that were asked, got"),
    ],
)
def test_changed_answers_are_refused(
    made: Path, harm: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = answers(made, "a", first)
    record = json.loads(path.read_text())
    harm(record)
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=message):
        read_answers([path], read_key(made / "key.json"), caught=0.5)


def test_pictures_that_not_all_have(
    pictures: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["-o", str(tmp_path / "out")]
    words = [f"{name}={folder}" for name, folder in pictures.items()]
    (pictures["papr"] / "objects" / "cup.png").unlink()
    for given, message in (
        (words, r"papr: expected the same pictures of every method, got none of 1 items"),
        (words[:1], "at least two methods to compare, got 1"),
        ([words[0], "papr"], "--pairs: expected NAME=PATH, got "),
        ([words[0], words[0]], "--pairs: expected different names, got ours, ours"),
        ([words[0], f"x={pictures['ours']}"], "expected a folder of each method's own, got"),
        ([words[0], f"x={tmp_path / 'none'}"], "expected a folder of pictures or films"),
        ([*words[::2], "--per-person", "7"], "expected 1 to 3 pairs per person, got 7"),
        ([*words[::2], "--catch", "-1"], "--catch: expected 0 or more, got -1"),
    ):
        assert main(["study", "make", "--pairs", *given, *out]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out" / "study.html").exists()


def test_damaged_pictures_and_a_group_called_all_are_refused(pictures: dict[str, Path]) -> None:
    for folder in pictures.values():
        (folder / "objects").rename(folder / "all")
    with pytest.raises(InputError, match="expected groups of other names than 'all'"):
        plan_study(pictures)
    for folder in pictures.values():
        (folder / "all").rename(folder / "objects")
    cup = pictures["papr"] / "objects" / "cup.png"
    for content in (b"no picture", cup.read_bytes()[:60]):
        cup.write_bytes(content)
        with pytest.raises(InputError, match=r"cup\.png: expected a picture, got a damaged one"):
            plan_study(pictures, catch=0)


def test_other_keys_are_refused(made: Path, tmp_path: Path) -> None:
    key = tmp_path / "key.json"
    key.write_text("[]")
    with pytest.raises(InputError, match="'top level': expected keys with values"):
        read_key(key)
    record = json.loads((made / "key.json").read_text())
    key.write_text(json.dumps({**record, "version": 9}))
    with pytest.raises(InputError, match="version 1, got 'pcore-study-key', version 9"):
        read_key(key)
    trials = record["trials"]
    swapped = {**trials[0], "keys": trials[0]["keys"][::-1]}
    for changed in ([*trials, trials[0]], trials[1:], [swapped, *trials[1:]]):
        key.write_text(json.dumps({**record, "trials": changed}))
        with pytest.raises(InputError, match=f"the {len(changed)} trials that make the id"):
            read_key(key)

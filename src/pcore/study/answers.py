"""Answers that people sent back: read strictly, counted once, catch trials looked at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from pcore.errors import InputError
from pcore.study.page import ANSWERS_FORMAT, KEY_FORMAT, VERSION, name_of
from pcore.validation import parse, read_json


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Answer(_Strict):
    """One choice of one person."""

    trial: int
    left: str
    right: str
    chosen: str
    seconds: Annotated[FiniteFloat, Field(ge=0)]


class Answers(_Strict):
    """All choices of one person, as the page writes them."""

    format: str
    version: int
    study: str
    person: str
    started: str
    asked: int
    answers: tuple[Answer, ...]


class _Trial(_Strict):
    item: str
    group: str
    first: str
    second: str
    keys: tuple[str, str]
    catch: bool


class Key(_Strict):
    """What the page does not say: which picture is whose."""

    format: str
    version: int
    study: str
    question: str
    trials: tuple[_Trial, ...]


File = TypeVar("File", Key, Answers)


class Sheets(BaseModel):
    """The answers that count, and what was odd about the others."""

    model_config = ConfigDict(frozen=True)

    people: tuple[Answers, ...]
    notes: tuple[str, ...]


def read_key(path: Path) -> Key:
    """Read the key that `pcore study make` wrote.

    Raises:
        InputError: it is none, or was changed.
    """
    key = _parsed(path, Key, "key of a study", KEY_FORMAT)
    if name_of(key.question, [one.model_dump() for one in key.trials]) != key.study:
        raise InputError(
            f"key of a study {path}: expected the question and the {len(key.trials)} trials that "
            f"make the id {key.study}, got others; give the key.json as `pcore study make` wrote it"
        )
    return key


def read_answers(paths: Sequence[Path], key: Key, *, caught: float) -> Sheets:
    """Read one file per person.

    Args:
        paths: the files; copies of one file count once.
        key: of the study.
        caught: share of the catch trials that a person must get right to count.

    Raises:
        InputError: damaged files, those of another study, two different ones of one person, trials
            that the study does not have, or nobody left.
    """
    people: dict[str, Answers] = {}
    notes: list[str] = []
    for path in paths:
        found = _read(path, key)
        before = people.get(found.person)
        if before is not None and before != found:
            raise InputError(
                f"{path}: expected one file per person, got a second one of person {found.person} "
                "with other answers; keep the one that counts"
            )
        if before is not None:
            notes.append(f"{path.name}: a copy of a file that is counted already")
            continue
        people[found.person] = found
        if 0 < len(found.answers) < found.asked:
            notes.append(f"{path.name}: {len(found.answers)} of {found.asked} pairs were answered")
    counted = [one for one in people.values() if _attentive(one, key, caught, notes)]
    if not counted:
        raise InputError(
            f"study: expected answers of at least one person who got {100 * caught:.0f} % of the "
            f"catch trials right, got none in {len(paths)} files"
        )
    return Sheets(people=tuple(counted), notes=tuple(notes))


def _read(path: Path, key: Key) -> Answers:
    found = _parsed(path, Answers, "answers", ANSWERS_FORMAT)
    if found.study != key.study:
        raise InputError(
            f"answers {path}: expected those of study {key.study}, got those of {found.study}; "
            "give the key.json that was made with its page"
        )
    _check_trials(path, found, key)
    return found


def _parsed(path: Path, kind: type[File], what: str, form: str) -> File:
    """Read a file of a study; raises InputError for another format or version."""
    where = f"{what} {path}"
    found = parse(kind, read_json(path, what=what, error=InputError), where=where, error=InputError)
    if (found.format, found.version) != (form, VERSION):
        raise InputError(
            f"{where}: expected format {form!r}, version {VERSION}, got {found.format!r}, version "
            f"{found.version}"
        )
    return found


def _check_trials(path: Path, found: Answers, key: Key) -> None:
    numbers = [one.trial for one in found.answers]
    twice = sorted({n for n in numbers if numbers.count(n) > 1})
    if twice:
        raise InputError(
            f"answers {path}: expected each pair once, got number {twice[0]} more than once; was "
            "the file changed?"
        )
    if len(numbers) > found.asked:
        raise InputError(
            f"answers {path}: expected at most the {found.asked} pairs that were asked, got "
            f"{len(numbers)}; was the file changed?"
        )
    for one in found.answers:
        known = 0 <= one.trial < len(key.trials)
        pair = set(key.trials[one.trial].keys) if known else set[str]()
        if {one.left, one.right} != pair or one.chosen not in pair:
            raise InputError(
                f"answers {path}: expected pictures of the study's pair {one.trial}, got "
                f"{one.left}, {one.right}, chosen {one.chosen}; was the file changed?"
            )


def _attentive(person: Answers, key: Key, caught: float, notes: list[str]) -> bool:
    """Whether somebody answered, and got enough catch trials right."""
    if not person.answers:
        notes.append(f"person {person.person}: no answers, not counted")
        return False
    known = [one for one in person.answers if key.trials[one.trial].catch]
    right = sum(one.chosen == key.trials[one.trial].keys[0] for one in known)
    if not known and caught > 0 and any(one.catch for one in key.trials):
        notes.append(f"person {person.person}: none of the catch trials answered, not counted")
        return False
    if right < caught * len(known):
        notes.append(
            f"person {person.person}: {right} of {len(known)} catch trials right, not counted"
        )
        return False
    return True

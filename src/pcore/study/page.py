"""A study as files: a page that needs no server, and the key that stays with who made it."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pcore.data.whole_file import replace_file
from pcore.errors import InputError
from pcore.evaluation.report import filled_page
from pcore.study.trials import Study

PAGE_FILE, KEY_FILE = "study.html", "key.json"
KEY_FORMAT, ANSWERS_FORMAT = "pcore-study-key", "pcore-study-answers"
VERSION = 1
QUESTION = (
    "Which picture has fewer geometric artifacts, such as holes, tears and parts that come apart?"
)
"""What the paper asked, in our words."""
_MOST_BYTES = 100_000_000
"""Of all pictures: larger pages are slow to open and hard to send."""


def write_study(folder: Path, study: Study, *, question: str, per_person: int | None) -> str:
    """Write the page and its key; returns the study's id.

    Args:
        folder: exists.
        study: what to ask.
        question: above every pair.
        per_person: how many of the pairs each person sees, drawn in their browser; None: all.

    Raises:
        DependencyError: jinja2 is not installed.
        InputError: pictures that are too many or too large for one page, or a number of pairs that
            there are not.
        OSError: a file cannot be written.
    """
    size = sum(len(one.content) for one in study.shown.values())
    if size > _MOST_BYTES:
        raise InputError(
            f"study: expected pictures of at most {_MOST_BYTES / 1e6:.0f} MB in all, got "
            f"{size / 1e6:.0f} MB; make several studies, or smaller pictures"
        )
    asked = [one for one in study.trials if not one.catch]
    if per_person is not None and not 1 <= per_person <= len(asked):
        raise InputError(f"study: expected 1 to {len(asked)} pairs per person, got {per_person}")
    trials = [asdict(one) for one in study.trials]
    name = name_of(question, trials)
    key = {
        "format": KEY_FORMAT,
        "version": VERSION,
        "study": name,
        "question": question,
        "trials": trials,
    }
    page = {
        "study": name,
        "format": ANSWERS_FORMAT,
        "version": VERSION,
        "perPerson": per_person,
        # In an order that does not tell which method is which.
        "trials": [{"keys": sorted(one.keys), "catch": one.catch} for one in study.trials],
        "shown": {
            one.key: {"kind": one.kind, "data": base64.b64encode(one.content).decode()}
            for one in study.shown.values()
        },
    }
    replace_file(folder / PAGE_FILE, _page(question, page).encode())
    replace_file(folder / KEY_FILE, (json.dumps(key, indent=1) + "\n").encode())
    return name


def name_of(question: str, trials: Sequence[Mapping[str, Any]]) -> str:
    """The id of a study, by what it asks: a key that was changed has another."""
    return hashlib.sha256(json.dumps([question, trials], sort_keys=True).encode()).hexdigest()[:12]


def _page(question: str, content: dict[str, Any]) -> str:
    # Inside a script element only "<" could end it.
    data = json.dumps(content).replace("<", "\\u003c")
    return filled_page("pcore.study", "study.html.j2", question=question, data=data)

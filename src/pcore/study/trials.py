"""What a study asks: pairs of pictures of two methods, and pairs whose answer is known."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from PIL import Image

from pcore.errors import InputError
from pcore.validation import first_names

KINDS = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
    ".gif": "image/gif",
    ".mp4": "video/mp4",
    ".webm": "video/webm",
}
"""File endings that a browser shows, and their media types."""
ALL = "all"
"""Name of the group that holds everything; no folder may be called so."""
_HOLES, _HOLE = 24, 0.035
"""Holes that are torn into a picture whose answer is to be known; their radius in its width."""
_PAPER = 245
"""Pixels at least so bright in every channel are the background, where a hole does not show."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture or film as the page carries it.

    Attributes:
        key: names it in the page and the answers; says nothing of its method.
        kind: media type.
        content: of the file.
    """

    key: str
    kind: str
    content: bytes


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A choice between two pictures.

    Attributes:
        item: what both show, such as `objaverse/kelpie-bend`.
        group: what it is counted with: the item's first folder, or "" without one.
        first: the method that is asked about; for a catch trial, the picture as it is.
        second: the one that it is compared with; for a catch trial, the damaged picture.
        keys: of both pictures.
        catch: whether the answer is known (`first`), so that it tells who looked.
    """

    item: str
    group: str
    first: str
    second: str
    keys: tuple[str, str]
    catch: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """All trials and what they show.

    Attributes:
        trials: in the order of the items.
        shown: key -> picture.
    """

    trials: tuple[Trial, ...]
    shown: Mapping[str, Shown]


def plan_study(
    methods: Mapping[str, Path], *, every_pair: bool = False, catch: int = 3, seed: int = 0
) -> Study:
    """Pair the pictures that methods have of the same items.

    Args:
        methods: name -> folder of its pictures; files of the same path below it, without its
            ending, show the same item. The first method is compared with each of the others.
        every_pair: compare all methods with one another instead.
        catch: trials whose answer is known: a picture of the first method against itself with
            holes torn into it.
        seed: of the keys and holes.

    Raises:
        InputError: fewer than two methods, or pictures that not all of them have.
    """
    if len(methods) < 2:
        raise InputError(
            f"study: expected at least two methods to compare, got {len(methods)}; give "
            "--pairs NAME=FOLDER NAME=FOLDER ..."
        )
    files = {name: _files_of(name, folder) for name, folder in methods.items()}
    items = _common(files, methods)
    names = list(methods)
    pairs = list(combinations(names, 2)) if every_pair else [(names[0], one) for one in names[1:]]
    used = dict.fromkeys(name for pair in pairs for name in pair)
    shown = {
        (name, item): _shown(files[name][item], f"{seed}/{name}/{item}")
        for name in used
        for item in items
    }
    trials = [
        Trial(
            item=item,
            group=_group(item),
            first=first,
            second=second,
            keys=(shown[first, item].key, shown[second, item].key),
        )
        for item in items
        for first, second in pairs
    ]
    every = {one.key: one for one in shown.values()}
    for number, item in enumerate(_still(items, shown, names[0])[:catch]):
        trial, torn = _catch(item, shown[names[0], item], seed + number)
        trials.append(trial)
        every[torn.key] = torn
    return Study(trials=tuple(trials), shown=every)


def _catch(item: str, picture: Shown, seed: int) -> tuple[Trial, Shown]:
    """A trial whose answer is known, and the picture with holes in it."""
    torn = _torn(picture, seed)
    trial = Trial(
        item=item,
        group="",
        first="as it is",
        second="with holes",
        keys=(picture.key, torn.key),
        catch=True,
    )
    return trial, torn


def _files_of(name: str, folder: Path) -> dict[str, Path]:
    """Files that a browser shows by their path below the folder, without the ending."""
    if not folder.is_dir():
        raise InputError(
            f"study: {name}: expected a folder of pictures or films, got {folder}, which is none"
        )
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix.lower() in KINDS:
            item = path.relative_to(folder).with_suffix("").as_posix()
            if item in found:
                raise InputError(
                    f"study: {name}: expected one file of each item, got {found[item].name} and "
                    f"{path.name} in {path.parent}; remove one"
                )
            found[item] = path
    if not found:
        raise InputError(
            f"study: {name}: expected pictures or films ({', '.join(KINDS)}) in {folder}, got none"
        )
    return found


def _common(files: Mapping[str, Mapping[str, Path]], methods: Mapping[str, Path]) -> list[str]:
    """Items that all methods have; InputError where one lacks some."""
    items = sorted(set[str]().union(*files.values()))
    if any(_group(item) == ALL for item in items):
        raise InputError(
            f"study: expected groups of other names than {ALL!r}, which stands for all of them "
            "together; rename the folder"
        )
    for name, found in files.items():
        missing = [item for item in items if item not in found]
        if missing:
            raise InputError(
                f"study: {name}: expected the same pictures of every method, got none of "
                f"{len(missing)} items ({first_names(missing)}) in {methods[name]}"
            )
    return items


def _group(item: str) -> str:
    return item.split("/", 1)[0] if "/" in item else ""


def _shown(path: Path, salt: str) -> Shown:
    content = path.read_bytes()
    if KINDS[path.suffix.lower()].startswith("image/"):
        try:
            with Image.open(io.BytesIO(content)) as opened:
                opened.verify()
        except (OSError, ValueError, SyntaxError):  # Pillow says the last of a damaged PNG.
            raise InputError(
                f"study: {path}: expected a picture, got a damaged one; make it again"
            ) from None
    return Shown(key=_key(salt, content), kind=KINDS[path.suffix.lower()], content=content)


def _key(salt: str, content: bytes) -> str:
    return hashlib.sha256(salt.encode() + content).hexdigest()[:12]


def _still(items: Sequence[str], shown: Mapping[tuple[str, str], Shown], method: str) -> list[str]:
    """Items of which the method has a picture that is no film."""
    return [i for i in items if shown[method, i].kind in ("image/png", "image/jpeg", "image/webp")]


def _torn(picture: Shown, seed: int) -> Shown:
    """The same picture with white holes where it shows something."""
    with Image.open(io.BytesIO(picture.content)) as opened:
        pixels = np.array(opened.convert("RGBA"))
    visible = (pixels[..., 3] > 0) & (pixels[..., :3].min(axis=-1) < _PAPER)
    places = np.argwhere(visible) if visible.any() else np.argwhere(np.ones(visible.shape, bool))
    draws = np.random.default_rng(seed).integers(len(places), size=_HOLES)
    rows, columns = np.indices(visible.shape)
    radius = max(1.0, _HOLE * visible.shape[1])
    for row, column in places[draws]:
        pixels[np.hypot(rows - row, columns - column) <= radius] = 255
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    content = buffer.getvalue()
    return Shown(key=_key(f"{seed}/torn", content), kind="image/png", content=content)

"""How options look in the help of a verb."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import arg

from pcore.errors import InputError


def optional(metavar: str, *aliases: str) -> Any:
    """Describe an option whose text says itself what holds without it.

    Args:
        metavar: what stands for its value in the help.
        aliases: short names, as "-o".
    """
    return arg(metavar=metavar, aliases=aliases, help_behavior_hint="")


PresetName = Literal["tiny", "fast", "paper"]
"""Settings that fine-tuning has a preset for."""

Count = Annotated[int | None, optional("N")]
"""A whole number that may be left out."""

Samples = Annotated[int | None, optional("N")]
"""Rays per pixel; may be left out."""

Number = Annotated[float | None, optional("X")]
"""A number that may be left out."""

Folder = Annotated[Path | None, optional("FOLDER")]
"""A folder that may be left out."""

Output = Annotated[Path | None, optional("FOLDER", "-o")]
"""Where results go; may be left out."""


def check_given_samples(samples: int | None) -> None:
    """Refuse rays per pixel that make no square grid, before any work is done."""
    from pcore.geometry.pixel_samples import check_samples

    if samples is not None:
        check_samples("--samples", samples)


def named_paths(option: str, texts: Sequence[str]) -> list[tuple[str, Path]]:
    """Names and paths of NAME=PATH."""
    pairs = [text.partition("=") for text in texts]
    if any(not name or not path for name, _, path in pairs):
        raise InputError(f"{option}: expected NAME=PATH, got {' '.join(texts)}")
    names = [name for name, _, _ in pairs]
    if len({*names}) < len(names):
        raise InputError(f"{option}: expected different names, got {', '.join(names)}")
    return [(name, Path(path)) for name, _, path in pairs]

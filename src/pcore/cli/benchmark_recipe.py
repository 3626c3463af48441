"""Recipes of `pcore benchmark make`: models by name, each with its file and its options."""

from __future__ import annotations

import io
import re
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

from pcore.cli.benchmark import BenchmarkMakeCommand
from pcore.cli.sweep_verbs import option_words
from pcore.errors import InputError
from pcore.validation import check_folder_name, parse, read_text

_OURS = {"models", "output", "o", "recipe"}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class _RecipeModel(_Strict):
    file: str
    """Seen from the recipe's own folder."""
    source: str = ""
    """Where people get it, for the message when it is not there."""
    options: dict[str, Any] = {}


class _Recipe(_Strict):
    version: Literal[1]
    options: dict[str, Any] = {}
    """Of all models, unless they have their own."""
    models: dict[str, _RecipeModel] = Field(min_length=1)


def commands_of(command: BenchmarkMakeCommand) -> list[BenchmarkMakeCommand]:
    """One command for each model of a recipe, into a folder of its name.

    Raises:
        InputError: a recipe that is wrong, files that are not there, or options besides the recipe.
    """
    recipe = command.recipe
    assert recipe is not None
    plain = BenchmarkMakeCommand(models=(), output=command.output, recipe=recipe)
    given = [
        one.name
        for one in fields(command)
        if getattr(command, one.name) != getattr(plain, one.name)
    ]
    if given:
        raise InputError(
            f"--recipe {recipe}: expected no models or options besides -o, got {', '.join(given)}; "
            "write them into the recipe"
        )
    where = f"recipe {recipe}"
    try:
        data = yaml.safe_load(read_text(recipe, where=where, error=InputError))
    except yaml.YAMLError as error:
        told = " ".join(str(error).split())
        raise InputError(f"{where}: expected YAML, got text that does not parse: {told}") from error
    found = parse(_Recipe, data, where=where, error=InputError)
    for name in found.models:
        check_folder_name(f"{where}: 'models'", name)
    missing = [
        f"{one.file} ({one.source})" if one.source else one.file
        for one in found.models.values()
        if not (recipe.parent / one.file).is_file()
    ]
    if missing:
        raise InputError(
            f"{where}: expected its models beside it, missing: {'; '.join(missing)}; bring them, "
            "or take them out of the recipe"
        )
    return [
        _parsed(
            f"{where}: {name}",
            recipe.parent / one.file,
            command.output / name,
            _placed({**found.options, **one.options}, recipe.parent),
        )
        for name, one in found.models.items()
    ]


def _placed(options: dict[str, Any], beside: Path) -> dict[str, Any]:
    """Options whose edit files are seen from the recipe's own folder, as models are."""
    edits = options.get("edits", [])
    files = edits if isinstance(edits, list) else [edits]
    return {**options, "edits": [str(beside / str(one)) for one in files]} if files else options


def _parsed(where: str, model: Path, output: Path, options: dict[str, Any]) -> BenchmarkMakeCommand:
    import tyro

    words = [
        str(model),
        "--output",
        str(output),
        *option_words(options, _OURS, where, giver="recipe"),
    ]
    told = io.StringIO()
    try:
        with redirect_stderr(told), redirect_stdout(told):
            return tyro.cli(
                BenchmarkMakeCommand, args=words, config=(tyro.conf.FlagCreatePairsOff,)
            )
    except SystemExit as error:
        reason = " ".join(re.sub(r"[^\x20-\x7e]", " ", told.getvalue()).split())
        raise InputError(
            f"{where}: {reason}; `pcore benchmark make --help` has all options"
        ) from error

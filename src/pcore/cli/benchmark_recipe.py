"""Recipes of `pcore benchmark make`: models by name, each with its file and its options."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import Field

from pcore.cli.benchmark import BenchmarkMakeCommand
from pcore.cli.sweep_verbs import option_words, parsed_words
from pcore.errors import InputError
from pcore.user_yaml import read_yaml
from pcore.validation import Strict, check_folder_names, parse

_OURS = {"models", "output", "o", "recipe"}


class _RecipeModel(Strict):
    file: str
    """Seen from the recipe's own folder."""
    source: str = ""
    """Where people get it, for the message when it is not there."""
    options: dict[str, Any] = Field(default_factory=dict)


class _Recipe(Strict):
    version: Literal[1]
    options: dict[str, Any] = Field(default_factory=dict)
    """Of all models, unless they have their own."""
    models: dict[str, _RecipeModel] = Field(min_length=1)


def commands_of(command: BenchmarkMakeCommand) -> list[BenchmarkMakeCommand]:
    """One command for each model of a recipe, into a folder of its name."""
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
    data = read_yaml(recipe, where=where, error=InputError)
    found = parse(_Recipe, data, where=where, error=InputError)
    check_folder_names(f"{where}: 'models'", found.models)
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
            [str(recipe.parent / one.file), "--output", str(command.output / name)],
            _placed(f"{where}: {name}", {**found.options, **one.options}, recipe.parent),
        )
        for name, one in found.models.items()
    ]


def _placed(where: str, options: dict[str, Any], beside: Path) -> dict[str, Any]:
    """Options whose edit files are seen from the recipe's own folder, as models are."""
    return {
        key: _files(f"{where}: '{key}'", value, beside) if key.lstrip("-") == "edits" else value
        for key, value in options.items()
    }


def _files(where: str, value: Any, beside: Path) -> list[str]:
    files = cast("list[Any]", value if isinstance(value, list) else [value])
    if not all(isinstance(one, str) for one in files):
        # `true` would be the bare option, which edits nothing, and a number a file of its name.
        raise InputError(f"{where}: expected an edit file or a list of them, got {value!r}")
    return [str(beside / one) for one in files]


def _parsed(where: str, own: list[str], options: dict[str, Any]) -> BenchmarkMakeCommand:
    words = [*own, *option_words(options, _OURS, where, giver="recipe")]
    return cast("BenchmarkMakeCommand", parsed_words("benchmark make", words, where))

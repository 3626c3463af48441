"""Write the pages of the reference that come from the code.

    python scripts/make_reference.py

docs/reference/names.md lists the public names for mkdocstrings; docs/reference/edit-file.md lists
what the pydantic models of the edit file take. `tests/test_reference.py` checks both.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

import pcore
from pcore.editing.regions import AnyRegion
from pcore.editing.registry import EDIT_TYPES

REFERENCE = Path(__file__).resolve().parent.parent / "docs" / "reference"
_MADE = "This page is made from the code by `scripts/make_reference.py`."


def names_page() -> str:
    """Every public name, by the module it is from."""
    parts = ["# Public names", f"{_MADE}\nAn example of each: [the tour](index.md)."]
    homes = {name: pcore._HOMES[name] for name in pcore.__all__ if name != "__version__"}
    parts += [f"::: {home}.{name}" for name, home in homes.items()]
    return "\n\n".join(parts) + "\n"


def edit_file_page() -> str:
    """Every type of edit and every region with its keys."""
    top = (
        f"{_MADE} Meaning and examples: [formulas](../guide/edit-types.md), "
        "[shapes](../guide/edit-shapes.md), [regions](../guide/regions.md). A key takes what "
        "stands behind it; numbers may be [keyframes](../guide/edit-files.md#keyframes)."
    )
    parts = ["# The edit file, key by key", *_wrapped(top)]
    for name, model in EDIT_TYPES.items():
        parts += ["", f"## {name}", "", *_wrapped(_about(model)), "", *_keys(model, "type")]
    parts += ["", "# Regions"]
    for model in _regions():
        shape = get_args(model.model_fields["shape"].annotation)[0]
        parts += ["", f"## {shape}", "", *_wrapped(_about(model)), "", *_keys(model, "shape")]
    return "\n".join([parts[0], "", *parts[1:]]) + "\n"


def _regions() -> list[type[BaseModel]]:
    return list(get_args(get_args(AnyRegion)[0]))


def _about(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split("\n\n")[0].split())


def _keys(model: type[BaseModel], kind: str) -> list[str]:
    lines = []
    for name, field in model.model_fields.items():
        if name != kind:
            lines += _wrapped(f"`{name}`: {_takes(field)}; {_default(field)}.", "- ")
    return lines


def _takes(field: FieldInfo) -> str:
    if field.description is not None:
        return field.description
    choices = [one for one in get_args(field.annotation) if isinstance(one, str)]
    return " or ".join(f'"{one}"' for one in choices) if choices else "see the guide"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default: Any = field.get_default(call_default_factory=True)
    return "optional" if default is None else f"default `{json.dumps(default)}`"


def _wrapped(text: str, mark: str = "") -> list[str]:
    return textwrap.wrap(
        text,
        100,
        initial_indent=mark,
        subsequent_indent=" " * len(mark),
        break_long_words=False,
        break_on_hyphens=False,
    )


def main() -> None:
    """Write both pages."""
    for name, text in (("names.md", names_page()), ("edit-file.md", edit_file_page())):
        (REFERENCE / name).write_text(text, encoding="utf-8")
        print(REFERENCE / name)


if __name__ == "__main__":
    main()

"""YAML that users write: plans of sweeps and recipes."""

from __future__ import annotations

import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from pcore.errors import PcoreError
from pcore.validation import read_text


def read_yaml(path: Path, *, where: str, error: type[PcoreError]) -> Any:
    """Parse a YAML file that a user gave: texts, numbers, lists and mappings; `read_text` reads it.

    Args:
        path: the file.
        where: what the file is, with its path; starts the message.
        error: the class to raise when it is missing or holds something else.
    """
    text = read_text(path, where=where, error=error)
    try:
        found = yaml.load(text, _OneOfEach)
        json.dumps(found, allow_nan=False)
    except yaml.YAMLError as problem:
        told = " ".join(str(problem).split())
        raise error(f"{where}: expected YAML, got text that does not parse: {told}") from problem
    except (TypeError, ValueError, RecursionError) as problem:
        raise error(
            f"{where}: expected texts, numbers, lists and mappings, got something else "
            f"({problem}); put quotes around dates and the like"
        ) from problem
    return found


class _OneOfEach(yaml.SafeLoader):
    """Refuses keys that stand twice, of which YAML would silently take the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        found = super().construct_mapping(node, deep=deep)
        names = [key.value for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge"]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise yaml.constructor.ConstructorError(
                None, None, f"the key {twice!r} stands twice", node.start_mark
            )
        return found

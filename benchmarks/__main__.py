"""`python -m benchmarks speed [--gate]`, `scaling`, `bars` and `captures DATA OUT`, `gpu DATA`.

`gpu` takes only packages that an image with PyTorch for a GPU has, and pydantic: see
docs/research/speed.md for how to bring that along.
"""

from __future__ import annotations

import argparse
import ast
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

FOLDER = Path(__file__).parent
COMMANDS = ("speed", "scaling", "bars", "captures", "gpu")
NEEDED = {
    "torch": "torch",
    "numpy": "numpy",
    "numba": "numba",
    "scipy": "scipy",
    "PIL": "pillow",
    "pydantic": "pydantic",
    "safetensors": "safetensors",
}
"""Modules and the packages that hold them."""


def main() -> int:
    """Run the command line."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name in ("-h", "--help"):
        print(overview())
        return 0
    missing = [package for module, package in NEEDED.items() if find_spec(module) is None]
    if missing:
        print(
            f"benchmarks: missing packages: {', '.join(missing)}; install them, or bring them in a "
            f"folder on PYTHONPATH (pip install --target FOLDER {' '.join(missing)})",
            file=sys.stderr,
        )
        return 2
    if name not in COMMANDS:
        print(
            f"benchmarks: expected {', '.join(COMMANDS[:-1])} or {COMMANDS[-1]}, got {name!r}; "
            "`python -m benchmarks --help` says what each is",
            file=sys.stderr,
        )
        return 2
    # Only what the command needs: `speed` looks at editing, too, which takes more packages.
    command = import_module(f"benchmarks.{name}")
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks {name}", description=command.__doc__
    )
    command.add_options(parser)
    return command.run(parser.parse_args(sys.argv[2:]))


def overview() -> str:
    """All commands, and programs of their own, each with the first line of its text."""
    own = [
        path.stem
        for path in sorted(FOLDER.glob("*.py"))
        if path.name != "__main__.py" and '\nif __name__ == "__main__":' in path.read_text("utf-8")
    ]
    return "\n".join(
        [
            "python -m benchmarks COMMAND [--help]",
            *map(_line, COMMANDS),
            "\npython -m benchmarks.PROGRAM [--help]",
            *map(_line, own),
        ]
    )


def _line(name: str) -> str:
    text = ast.get_docstring(ast.parse((FOLDER / f"{name}.py").read_text("utf-8"))) or ""
    return f"  {name:18} {text.splitlines()[0].split('`: ')[-1]}"


if __name__ == "__main__":
    sys.exit(main())

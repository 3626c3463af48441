"""`python -m benchmarks speed [--gate]`, `scaling`, `bars` and `captures DATA OUT`, `gpu DATA`.

`gpu` takes only packages that an image with PyTorch for a GPU has, and pydantic: see
docs/research/speed.md for how to bring that along.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from importlib.util import find_spec

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
    missing = [package for module, package in NEEDED.items() if find_spec(module) is None]
    if missing:
        print(
            f"benchmarks: missing packages: {', '.join(missing)}; install them, or bring them in a "
            f"folder on PYTHONPATH (pip install --target FOLDER {' '.join(missing)})",
            file=sys.stderr,
        )
        return 2
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in COMMANDS:
        print(
            f"benchmarks: expected {', '.join(COMMANDS[:-1])} or {COMMANDS[-1]}, got {name!r}",
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


if __name__ == "__main__":
    sys.exit(main())

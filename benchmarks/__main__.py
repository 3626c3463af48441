"""`python -m benchmarks speed [--out FILE] [--gate]` and `python -m benchmarks gpu DATA`.

Only packages that a bare machine with PyTorch for a GPU has, and pydantic: see
docs/benchmarks/speed.md for how to bring that along.
"""

from __future__ import annotations

import argparse
import sys
from importlib.util import find_spec

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
    # What is missing is to be said before it is imported.
    from benchmarks import gpu, speed

    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    commands = parser.add_subparsers(required=True)
    for name, module in (("speed", speed), ("gpu", gpu)):
        command = commands.add_parser(name, help=(module.__doc__ or "").split("\n")[0])
        module.add_options(command)
        command.set_defaults(run=module.run)
    wanted = parser.parse_args()
    return wanted.run(wanted)


if __name__ == "__main__":
    sys.exit(main())

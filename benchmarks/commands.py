"""`pcore` called in a process of its own, as a user does."""

from __future__ import annotations

import shlex
import subprocess
import sys


def run_pcore(*words: str, dry: bool = False) -> int:
    """Say the command line, run it unless it is only to be said, and return its exit code."""
    print(f"$ pcore {shlex.join(words)}", flush=True)
    if dry:
        return 0
    return subprocess.run([sys.executable, "-m", "pcore.cli.main", *words], check=False).returncode

"""Programs that import Triton: whether it interprets is decided then, in processes of their own."""

from __future__ import annotations

from pathlib import Path

from tests.forked import Forked

_BEFORE = """
import os, sys
assert "triton" not in sys.modules, "it is too late to choose whether Triton interprets"
os.environ.update({about!r})
"""


def run_triton(
    forked: Forked, code: str, *words: str, folder: Path, interpreted: bool = False
) -> None:
    """Run code to its end, with Triton's cache in a folder."""
    about = {"TRITON_CACHE_DIR": str(folder), "TRITON_INTERPRET": str(int(interpreted))}
    before = _BEFORE.format(about=about)
    done = forked.start(before + code, *words, said=folder / "said.txt")
    assert done.wait() == 0, done.said.read_text()

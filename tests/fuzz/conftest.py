"""What the fuzz tests share with those of files and of commands."""

import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
sys.path += [str(TESTS / "data"), str(TESTS / "cli")]

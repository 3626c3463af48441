"""What draws Gaussians on this machine, and what a GPU would need for it."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

_EXTENSION = "gsplat_cuda"


def gaussian_report(installed: Callable[[str], str | None]) -> tuple[str, str]:
    """Say which backend draws Gaussians, and what is missing; "" for nothing.

    gsplat compiles its CUDA code when it draws for the first time, and is not asked to here.

    Args:
        installed: gives the version of a package.
    """
    import torch

    if not torch.cuda.is_available():
        return f"cpu (numba {installed('numba')})", ""
    if find_spec("gsplat") is None:
        return (
            "none for cuda",
            "Gaussians on a GPU need gsplat: `pip install 'pcore-edit[gsplat]'`",
        )
    value = f"gsplat for cuda ({installed('gsplat')})"
    if _built():
        return f"{value}, compiled", ""
    return f"{value}, not compiled yet", _compiler_advice(torch.version.cuda or "")


def _built() -> bool:
    """Whether torch has compiled gsplat's extension for this user before."""
    from torch.utils import cpp_extension

    root = Path(cpp_extension.get_default_build_root())
    return any(root.glob(f"**/{_EXTENSION}/*.so"))


def _compiler_advice(cuda: str) -> str:
    """What stands against compiling CUDA code for this torch; "" for nothing."""
    nvcc = shutil.which("nvcc")
    if nvcc is None:
        return (
            "its first picture compiles CUDA code, and nvcc is not found: install CUDA's toolkit "
            f"{cuda}, or draw with --device cpu"
        )
    if find_spec("ninja") is None and shutil.which("ninja") is None:
        return "its first picture compiles CUDA code and needs ninja: `pip install ninja`"
    said = subprocess.run([nvcc, "--version"], capture_output=True, text=True, check=False).stdout
    found = re.search(r"release (\d+)\.(\d+)", said)
    if found is None or found.group(1) != cuda.split(".")[0]:
        got = found.group(0) if found else "an unknown version"
        return f"nvcc is {got}, and torch was built for CUDA {cuda}: install that toolkit"
    return ""

"""`pcore doctor`: what this machine has, what is missing and what would be slow."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.text import Text

from pcore.cli.console import say
from pcore.demo.machine import usable_cores
from pcore.errors import InputError

_OPTIONAL = (
    ("embreex", "sample", "no embedded sample (`pcore demo`), no true depth of meshes"),
    ("imageio", "video", "no orbit videos"),
    ("av", "video", "no orbit videos"),
    ("tensorboard", "log", "no TensorBoard log; log.jsonl is always written"),
    ("jinja2", "report", "no HTML report"),
    ("matplotlib", "report", "no figures"),
    ("skimage", "metrics", "no SSIM"),
    ("gaussforge", "splats", "compressed files of Gaussians (.spz, .sog) are not read"),
    ("cv2", "capture", "no automatic masks, no masks in `pcore check`"),
)
_MEMORY_WANTED = 4e9
_DISK_WANTED = 1e9


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of the report."""

    name: str
    value: str
    good: bool = True
    advice: str = ""
    """What it means and how to mend it, when it is not good."""


@dataclass(frozen=True, kw_only=True)
class DoctorCommand:
    """Check this machine: packages, device, memory, weights, and what would be slow."""

    weights: bool = False
    """Only list the files of LPIPS: which are there, which are missing, where they go."""

    def run(self) -> None:
        """Print the report."""
        console = Console()
        findings = weight_files() if self.weights else examine()
        width = max(len(finding.name) for finding in findings)
        for finding in findings:
            mark = ("ok", "green") if finding.good else ("--", "yellow")
            line = f"  {finding.name:{width}}  {finding.value}"
            # Not wrapped: file names and addresses in it are there to be copied.
            say(console, Text.assemble(mark, line))
            if finding.advice:
                say(console, f"{'':{width + 6}}{finding.advice}")


def examine() -> list[Finding]:
    """Look at everything; costs the import of torch and numba."""
    return [
        *_versions(),
        _device(),
        _threads(),
        _memory(),
        _disk(Path.cwd()),
        *_kernels(),
        _gaussians(),
        *_packages(),
        _lpips(),
    ]


def _versions() -> list[Finding]:
    import torch

    names = [("pcore", installed("pcore-edit")), ("torch", str(torch.__version__))]
    names.insert(1, ("python", platform.python_version()))
    return [Finding(name=name, value=value or "not installed") for name, value in names]


def installed(package: str) -> str | None:
    """Return the version of an installed distribution, or None."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _device() -> Finding:
    import torch

    if torch.cuda.is_available():
        properties = torch.cuda.get_device_properties(0)
        memory = properties.total_memory / 1e9
        return Finding(name="device", value=f"{properties.name}, {memory:.0f} GB")
    return Finding(
        name="device",
        value="CPU only",
        good=False,
        advice="presets `fast` and `paper` would take many hours to days here: use `tiny`",
    )


def _threads() -> Finding:
    import torch

    used, there = torch.get_num_threads(), usable_cores()
    value = f"{used} of {there} usable cores"
    if used < there:
        return Finding(
            name="threads",
            value=value,
            good=False,
            advice="training is slower than it could be: OMP_NUM_THREADS or torch limits it",
        )
    return Finding(name="threads", value=value)


def memory_bytes(limit_file: Path = Path("/sys/fs/cgroup/memory.max")) -> int | None:
    """Memory this process may use: the machine's, or its container's when that is less."""
    try:
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
    try:
        text = limit_file.read_text().strip()
    except OSError:
        return total
    return min(total, int(text)) if text.isdigit() else total


def _memory() -> Finding:
    total = memory_bytes()
    if total is None:
        return Finding(name="memory", value="unknown on this system")
    if total < _MEMORY_WANTED:
        return Finding(
            name="memory",
            value=f"{total / 1e9:.1f} GB",
            good=False,
            advice=f"less than {_MEMORY_WANTED / 1e9:.0f} GB: `pcore demo` may not fit",
        )
    return Finding(name="memory", value=f"{total / 1e9:.1f} GB")


def _disk(folder: Path) -> Finding:
    free = shutil.disk_usage(folder).free
    good = free >= _DISK_WANTED
    return Finding(
        name="disk",
        value=f"{free / 1e9:.1f} GB free in {folder}",
        good=good,
        advice="" if good else "a run with its pictures may not fit: free some space",
    )


def _kernels() -> list[Finding]:
    """Say which backend searches neighbours and which attends to them, and why these."""
    import torch

    from pcore.kernels.backends import LARGEST_WIDTH, MOST_FOUND, MOST_NEIGHBOURS, backend

    kind = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        used = backend(torch.device(kind))
    except InputError as error:
        # The report is where people look when nothing else runs.
        refused = f"none for {kind}"
        return [
            Finding(name=name, value=refused, good=False, advice=str(error))
            for name in ("search", "attention")
        ]
    package = {"cpu": "numba", "triton": "triton"}.get(used)
    reason = f"{package} {installed(package)}" if package else "plain PyTorch"
    if "PCORE_KERNELS" in os.environ:
        reason += ", chosen by PCORE_KERNELS"
    advice = ""
    if used == "reference":
        mend = (
            "unset PCORE_KERNELS" if kind == "cpu" else "`pip install triton`, PCORE_KERNELS unset"
        )
        advice = f"the reference kernels are slow: {mend}"
    search = attention = f"{used} for {kind} ({reason})"
    if used == "triton":
        search += f"; reference beyond {MOST_FOUND} neighbours"
        attention += (
            f"; reference beyond {LARGEST_WIDTH} wide layers and {MOST_NEIGHBOURS} neighbours"
        )
    return [
        Finding(name="search", value=search, good=not advice, advice=advice),
        Finding(name="attention", value=attention, good=not advice, advice=advice),
    ]


def _gaussians() -> Finding:
    from pcore.cli.doctor import gaussian_report

    value, advice = gaussian_report(installed)
    return Finding(name="Gaussians", value=value, good=not advice, advice=advice)


def _packages() -> list[Finding]:
    """One line for all that is there, one for each that is missing."""
    there = [name for name, _, _ in _OPTIONAL if find_spec(name) is not None]
    findings = [Finding(name="packages", value=", ".join(there) or "no optional one")]
    for name, extra, loss in _OPTIONAL:
        if name not in there:
            mend = f"{loss}; `pip install 'pcore-edit[{extra}]'` brings it"
            findings.append(Finding(name=name, value="not installed", good=False, advice=mend))
    return findings


def _lpips() -> Finding:
    """Say in one line which weights are there."""
    from pcore.metrics.perceptual import find_weights
    from pcore.metrics.trunks import TRUNKS

    missing = [trunk for trunk in TRUNKS if find_weights(trunk) is None]
    there = [trunk for trunk in TRUNKS if trunk not in missing]
    value = ", ".join([*there, *([f"no weights of {', '.join(missing)}"] if missing else [])])
    advice = "`pcore doctor --weights` says which files go where" if missing else ""
    return Finding(name="LPIPS", value=value, good=not missing, advice=advice)


def weight_files() -> list[Finding]:
    """For each trunk of LPIPS its files, or what is missing and how to get it."""
    from pcore.metrics.perceptual import find_weights, missing_weights
    from pcore.metrics.trunks import TRUNKS

    findings: list[Finding] = []
    for trunk in TRUNKS:
        paths = find_weights(trunk)
        name = f"LPIPS {trunk}"
        if paths is None:
            advice = missing_weights(trunk) or ""
            findings.append(Finding(name=name, value="missing", good=False, advice=advice))
        else:
            findings.append(Finding(name=name, value=f"{paths.trunk}, {paths.heads}"))
    return findings


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

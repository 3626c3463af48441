"""What the heavy verbs do before they begin: device, threads, memory, model and scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from pcore.files.model_file import SavedModel
    from pcore.files.run_folder import RunFolder

DeviceName = Literal["auto", "cpu", "cuda"]


def prepare_torch(threads: int | None = None) -> None:
    """Set this process up for heavy work; call it once, before large tensors are made.

    Args:
        threads: of torch and of the kernels; None leaves torch's choice.

    Raises:
        InputError: fewer than one thread.
    """
    import torch

    from pcore.kernels.memory import keep_freed_memory
    from pcore.validation import check_count

    if threads is not None:
        torch.set_num_threads(check_count("--threads", threads))
    keep_freed_memory()
    # Vanishing weights of the softmax and Adam's moments would be computed in slow motion.
    torch.set_flush_denormal(True)


def pick_device(name: DeviceName) -> str:
    """Return the device to compute on: "cuda" or "cpu"; auto takes a GPU where there is one.

    Raises:
        InputError: a GPU was asked for and torch finds none.
    """
    import torch

    from pcore.errors import InputError

    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        why = (
            "this torch was built for the CPU only; install one with CUDA"
            if torch.version.cuda is None
            else "check the driver"
        )
        raise InputError(
            f"--device cuda: expected a GPU that torch {torch.__version__} can use, found none: "
            f"{why}, or use --device cpu"
        )
    return name


def open_model(path: Path) -> tuple[SavedModel, RunFolder | None]:
    """Read a model from a run folder or a bare model file; the run is None for a bare file.

    Raises:
        CheckpointError: there is neither, or it is damaged.
    """
    from pcore.files.model_file import load_model
    from pcore.files.run_folder import RunFolder

    run = RunFolder.open(path) if path.is_dir() else None
    return load_model(path), run


def recorded_scene(run: RunFolder | None) -> Path | None:
    """Folder of the scene that a run was trained on; None when it is not on this machine."""
    if run is None or not run.scene:
        return None
    if run.stage == "import":
        return None  # It records a name, and a folder of that name may be anything.
    # Our own runs record it as seen from the run, so that both can move together.
    candidates = (run.path / run.scene, Path(run.scene))
    return next((folder for folder in candidates if folder.is_dir()), None)


def scene_of(run: RunFolder, given: Path | None) -> Path:
    """Folder of the scene to work on: the one given, else the one the run was trained on.

    Raises:
        InputError: none is given and that of the run is not there (any more).
    """
    from pcore.errors import InputError

    folder = given or recorded_scene(run)
    if folder is None:
        raise InputError(
            f"{run.path}: the scene it was trained on ({run.scene or 'not recorded'}) is not a "
            "folder here; give the scene's folder with --scene"
        )
    return folder


def recorded_factor(run: RunFolder | None) -> int:
    """Down-scaling factor that a run was trained with; 1 when none is on record."""
    found = None if run is None else run.config.get("factor")
    return found if isinstance(found, int) and found > 0 else 1

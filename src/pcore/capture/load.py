"""Recognise a scene's format and load it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pcore.capture.mask_folder import masks_beside, with_masks
from pcore.data.blender import load_splits, transforms_path
from pcore.data.images import DEFAULT_MEMORY_BUDGET, ImageCache
from pcore.data.scene import Scene
from pcore.data.transforms import read_transforms
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.validation import check_count

START, END = "start", "end"


def load_scene(
    path: str | Path,
    *,
    factor: int = 1,
    memory_budget: int = DEFAULT_MEMORY_BUDGET,
    masks: Path | Literal["none"] | None = None,
) -> Scene:
    """Load a scene of any format that pcore knows.

    NeRF-Synthetic (`transforms_train.json` in the folder; sub-folders with a
    `transforms_test.json` are its deformed states) or PAPR in Motion (folders `start` and `end`,
    each NeRF-Synthetic; the scene is `start`, the only state is `end`).

    Args:
        path: the scene's folder.
        factor: whole number by which images are down-scaled (area mean of premultiplied colour).
        memory_budget: bytes of decoded images kept, shared by all views of the scene.
        masks: folder of masks made elsewhere (`with_masks`); None takes one beside photos that have
            no alpha channel, "none" leaves it alone.

    Training views are read now. Other splits are read when they are asked for: a missing test
    image does not keep anybody from training.

    Raises:
        SceneError: unknown format, or files missing, damaged or inconsistent.
        InputError: a factor that does not divide the image size.
    """
    folder = _folder(path)
    check_count("down-scaling factor", factor)
    cache = ImageCache(memory_budget)
    root = folder / START if _is_pair(folder) else folder
    if not transforms_path(root, "train").is_file():
        raise SceneError(_unknown_format(folder))
    views = load_splits(root, factor=factor, cache=cache)
    scene = Scene(
        name=folder.name,
        root=root,
        views=views,
        states=find_states(folder),
        folder=folder,
        factor=factor,
    )
    scene.split("train")  # Read now: without training views there is no scene.
    chosen = masks_beside(scene) if masks is None else masks
    return scene if chosen is None or chosen == "none" else with_masks(scene, Path(chosen))


def find_states(path: str | Path) -> tuple[str, ...]:
    """Names of the deformed states in a scene's folder, sorted."""
    folder = _folder(path)
    if _is_pair(folder):
        return (END,)
    return tuple(
        sorted(
            child.name
            for child in folder.iterdir()
            if child.is_dir() and transforms_path(child, "test").is_file()
        )
    )


def load_state(
    path: str | Path,
    name: str,
    *,
    factor: int = 1,
    memory_budget: int = DEFAULT_MEMORY_BUDGET,
) -> Scene:
    """Load the true images of a deformed state; cameras and field of view are the state's own.

    Args:
        path: the scene's folder, as for `load_scene`.
        name: one of `Scene.states`.
        factor: as for `load_scene`.
        memory_budget: as for `load_scene`.
    """
    folder = _folder(path)
    states = find_states(folder)
    if name not in states:
        raise SceneError(
            f"scene {folder}: no state {name!r}; it has {', '.join(states) or 'no states'}"
        )
    check_count("down-scaling factor", factor)
    views = load_splits(folder / name, factor=factor, cache=ImageCache(memory_budget))
    state = Scene(name=f"{folder.name}/{name}", root=folder / name, views=views)
    state.split("test" if "test" in state.splits else "train")  # Read now: what a state is for.
    return state


def load_cameras(
    path: str | Path, *, width: int | None = None, height: int | None = None
) -> list[tuple[str, Camera]]:
    """Load cameras of the NeRF-Synthetic form; no images are needed or looked at.

    Args:
        path: a transforms file.
        width: image width in pixels; with `height`, wins over `w` and `h` of the file.
        height: image height in pixels.

    Returns:
        (name, camera) for each frame, in the file's order; names are unique and safe as file names.
    """
    if (width is None) != (height is None):
        raise InputError(
            f"camera size: expected width and height or neither, got {width} x {height}"
        )
    transforms = read_transforms(Path(path))
    given: tuple[int, int] | None = None
    if width is not None and height is not None:
        given = (check_count("width", width), check_count("height", height))
    cameras: list[tuple[str, Camera]] = []
    for frame in transforms.frames:
        size = given or frame.lens.full_size
        if size is None:
            raise SceneError(
                f"scene file {path}: says no image size; add 'w' and 'h' to it or give width and "
                "height"
            )
        cameras.append((frame.name, transforms.camera(frame, size)))
    return cameras


def camera_notes(path: str | Path) -> tuple[str, ...]:
    """What is odd about a file of cameras and was not refused, a sentence each.

    Raises:
        SceneError: as `load_cameras`.
    """
    return read_transforms(Path(path)).notes


def _folder(path: str | Path) -> Path:
    folder = Path(path)
    if not folder.exists():
        raise SceneError(f"scene {folder}: no such folder; check the path")
    if not folder.is_dir():
        raise SceneError(
            f"scene {folder}: expected a folder, got a file; give the folder it lies in"
        )
    # Resolved, so that a scene given as "." has a name.
    return folder.resolve()


def _is_pair(folder: Path) -> bool:
    return all(transforms_path(folder / side, "train").is_file() for side in (START, END))


def _unknown_format(folder: Path) -> str:
    pair = [
        f"{side}/transforms_train.json"
        for side in (START, END)
        if not transforms_path(folder / side, "train").is_file()
    ]
    return (
        f"scene {folder}: unknown format. Tried: NeRF-Synthetic (missing transforms_train.json); "
        f"PAPR in Motion (missing {', '.join(pair)}). Convert the scene to one of them or give "
        "the folder that holds these files"
    )

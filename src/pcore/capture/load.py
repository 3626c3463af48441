"""Recognise a scene's format and load it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

from pcore.capture.assemble import scene_of
from pcore.capture.layouts import PHOTOS, RENDERED, VIDEO, layout_of, read_layout
from pcore.capture.mask_folder import scene_with_masks
from pcore.capture.photo_folders import with_masks
from pcore.capture.state_folders import files_of, is_pair, state_files
from pcore.capture.structure import Tell, is_posed, with_poses
from pcore.data.blender import load_splits
from pcore.data.images import DEFAULT_MEMORY_BUDGET, ImageCache
from pcore.data.scene import Scene
from pcore.data.transforms import read_transforms
from pcore.errors import InputError, SceneError
from pcore.geometry.camera import Camera
from pcore.validation import check_count


def load_scene(
    path: str | Path,
    *,
    factor: int = 1,
    memory_budget: int = DEFAULT_MEMORY_BUDGET,
    masks: Path | Literal["none"] | None = None,
    tell: Tell | None = None,
) -> Scene:
    """Load a scene or capture of any layout that pcore knows; the layout is found by itself.

    Rendered scenes: NeRF-Synthetic (`transforms_train.json`; sub-folders with a
    `transforms_test.json` are deformed states, and so are time stamps: `capture.state_folders`)
    and PAPR in Motion (folders `start` and `end`, each NeRF-Synthetic). Captures: COLMAP,
    `transforms.json` of nerfstudio and instant-ngp, IDR and NeuS, LLFF, NSVF, `cameras.json` of 3D
    Gaussian splatting; photos of bent lenses are straightened. Photos alone and videos get their
    poses from COLMAP (extra `colmap`), once; they are kept in the user's cache. Nothing is ever
    written into the folder.

    Args:
        path: the scene's folder; of one with several layouts, the file or model that is meant.
        factor: whole number by which images are down-scaled (area mean of premultiplied colour).
        memory_budget: bytes of decoded images kept, shared by all views of the scene.
        masks: folder of masks made elsewhere (`scene_with_masks`); "none" takes photos of captures
            without any; None takes those that the files name or that lie beside the photos.
        tell: called with a line now and then where poses must be found first.

    Training views are read now. Other splits of rendered scenes are read when they are asked for: a
    missing test image does not keep anybody from training.

    Raises:
        SceneError: unknown format, several layouts, or files missing, damaged or inconsistent.
        InputError: a factor that does not divide the image size of a rendered scene.
        DependencyError: poses must be found and COLMAP is not installed.
    """
    scene = _open(path, factor, ImageCache(memory_budget), masks == "none", tell or _silent)
    return scene if masks is None or masks == "none" else scene_with_masks(scene, masks)


def _open(path: str | Path, factor: int, cache: ImageCache, bare: bool, tell: Tell) -> Scene:
    given = _path(path)
    check_count("down-scaling factor", factor)
    if given.is_dir() and is_pair(given):
        return _rendered(given, factor, cache)
    layout = layout_of(given)
    if layout.name == RENDERED:
        return _rendered(layout.root, factor, cache)
    if layout.name in (PHOTOS, VIDEO):
        layout = with_poses(layout, tell)
    capture = read_layout(layout, factor)
    if bare:
        capture = replace(
            capture, photos=[replace(one, mask=None, clear=()) for one in capture.photos]
        )
    else:
        photos, notes = with_masks(capture.photos, layout.root)
        capture = replace(capture, photos=photos, notes=[*capture.notes, *notes])
    scene = scene_of(capture, root=layout.root, given=given, factor=factor, cache=cache)
    scene.split("train")  # So that its notes are known.
    return scene


def has_poses(path: str | Path) -> bool:
    """Whether `load_scene` opens a scene at once; else it has COLMAP find poses first.

    Raises:
        SceneError: there is no scene, or several.
    """
    given = _path(path)
    if given.is_dir() and is_pair(given):
        return True
    layout = layout_of(given)
    return layout.name not in (PHOTOS, VIDEO) or is_posed(layout)


def _silent(line: str) -> None:
    del line


def _rendered(folder: Path, factor: int, cache: ImageCache) -> Scene:
    files = files_of(folder)
    scene = Scene(
        name=folder.name,
        root=files.root,
        views=load_splits(files.splits, factor=factor, cache=cache, note=files.note),
        states=tuple(files.states),
        folder=folder,
        factor=factor,
    )
    scene.split("train")  # Read now: without training views there is no scene.
    return scene


def find_states(path: str | Path) -> tuple[str, ...]:
    """Names of the deformed states in a scene's folder: sub-folders by name, then times."""
    return tuple(state_files(_folder(path)))


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
    states = state_files(folder)
    if name not in states:
        raise SceneError(
            f"scene {folder}: no state {name!r}; it has {', '.join(states) or 'no states'}"
        )
    check_count("down-scaling factor", factor)
    views = load_splits(states[name], factor=factor, cache=ImageCache(memory_budget))
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


def _path(path: str | Path) -> Path:
    given = Path(path)
    if not given.exists():
        raise SceneError(f"scene {given}: no such folder; check the path")
    # Resolved, so that a scene given as "." has a name.
    return given.resolve()


def _folder(path: str | Path) -> Path:
    given = _path(path)
    return given if given.is_dir() else given.parent

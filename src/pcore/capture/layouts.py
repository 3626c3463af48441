"""Which layouts a folder holds: a look at the names of files, and no decision behind one's back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pcore.capture.archives import IDR_FILES, read_idr, read_llff
from pcore.capture.colmap import FoundModel, find_model, largest_model, read_colmap
from pcore.capture.colmap_model import kind_of
from pcore.capture.phone_folders import (
    METADATA,
    polycam_cameras,
    read_polycam,
    read_record3d,
    record3d_metadata,
)
from pcore.capture.photos import VIDEOS, Capture, inside, photos_below, pictures_in
from pcore.capture.pose_files import is_camera_list, read_camera_list, read_nsvf
from pcore.capture.transforms_capture import read_transforms_capture
from pcore.data.blender import transforms_path
from pcore.errors import SceneError

RENDERED = "NeRF-Synthetic"
"""The strict layout of rendered scenes, which `data.blender` reads."""
PHOTOS, VIDEO = "folder of photos", "video"
"""What has no poses yet."""
_PHOTO_FOLDERS = (".", "images", "input")
_UP = 4
"""How far above a model its photos are looked for."""


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A layout that a folder holds.

    Attributes:
        name: of the layout.
        root: folder of the capture, which nothing is read outside of.
        path: file or folder that makes it this layout; `load_scene` of it chooses it.
        note: what was left out, or "".
    """

    name: str
    root: Path
    path: Path
    note: str = ""


def layouts_of(root: Path) -> Sequence[Layout]:
    """All layouts that a folder holds.

    A layout that another one was made of is not a second one: nerfstudio keeps the model of COLMAP
    in `colmap/` beside its transforms.json, and LLFF's poses_bounds.npy is written from a model.
    """
    found: list[Layout] = []

    def add(name: str, path: Path, note: str = "") -> None:
        found.append(Layout(name=name, root=root, path=path, note=note))

    if transforms_path(root, "train").is_file():
        add(RENDERED, transforms_path(root, "train"))
    if (root / "transforms.json").is_file():
        add("transforms.json", root / "transforms.json")
    archive = next((root / name for name in IDR_FILES if (root / name).is_file()), None)
    if archive is not None:
        add("IDR / NeuS", archive)
    model = find_model(root)
    source = model is not None and "colmap" in model.folder.relative_to(root).parts
    if model is not None and not (source and (root / "transforms.json").is_file()):
        add("COLMAP", model.folder, model.note)
    if (root / "poses_bounds.npy").is_file() and model is None:
        add("LLFF", root / "poses_bounds.npy")
    if (root / "intrinsics.txt").is_file() and (root / "pose").is_dir():
        add("NSVF / Tanks and Temples", root / "intrinsics.txt")
    if is_camera_list(root / "cameras.json"):
        add("3DGS cameras.json", root / "cameras.json")
    # What was made of a phone's folder lies beside it and is better.
    return found or _of_phones(root) or _without_poses(root)


def layout_of(path: Path) -> Layout:
    """The one layout of what was given: a folder, or a file or model folder that chooses one.

    Raises:
        SceneError: nothing that is read, several layouts (names all and how to choose), or a
            symbolic link that leads out of the folder.
    """
    if path.is_file():
        return _of_file(path)
    photos_above = path.name != path.parent.name and kind_of(path) is not None
    if photos_above and not _has_photos(path):
        return Layout(name="COLMAP", root=_root_of_model(path), path=path)
    found = layouts_of(path)
    if not _has_photos(path) and (not found or found[0].name == PHOTOS):
        _check_one(path)
        found = found or _of_models(path)
    if not found:
        raise SceneError(_unknown(path))
    if len(found) > 1:
        listed = "; ".join(f"{one.name} (give {one.path})" for one in found)
        raise SceneError(
            f"scene {path}: holds {len(found)} layouts, and they may disagree: {listed}. Give the "
            "path of the one that is meant instead of the folder"
        )
    inside(found[0].root, found[0].path)
    return replace(found[0], note=found[0].note or _posed_above(found[0]))


def read_layout(layout: Layout, factor: int) -> Capture:
    """Read the files of a layout that has poses.

    Raises:
        SceneError: damaged or inconsistent files.
    """
    if layout.name == "COLMAP":
        return read_colmap(layout.root, FoundModel(folder=layout.path, note=layout.note), factor)
    return _READERS[layout.name](layout.root, layout.path, factor)


_READERS: dict[str, Callable[[Path, Path, int], Capture]] = {
    "transforms.json": read_transforms_capture,
    "IDR / NeuS": read_idr,
    "LLFF": read_llff,
    "NSVF / Tanks and Temples": read_nsvf,
    "3DGS cameras.json": read_camera_list,
    "Polycam": read_polycam,
    "Record3D": read_record3d,
}
_FILES = {
    "transforms_train.json": RENDERED,
    "transforms.json": "transforms.json",
    "poses_bounds.npy": "LLFF",
    "intrinsics.txt": "NSVF / Tanks and Temples",
    "cameras.json": "3DGS cameras.json",
    METADATA: "Record3D",
    **dict.fromkeys(IDR_FILES, "IDR / NeuS"),
}


def _of_file(path: Path) -> Layout:
    name = _FILES.get(path.name)
    if name is None and path.suffix.lower() in VIDEOS:
        name = VIDEO
    if name is None:
        packed = "unpack it and " * (path.suffix.lower() == ".zip")
        raise SceneError(
            f"scene {path}: expected a folder, got a file; {packed}give the folder it lies in, a "
            f"video, or one of {', '.join(_FILES)}"
        )
    return Layout(name=name, root=path.parent, path=path)


def _of_models(path: Path) -> Sequence[Layout]:
    """The folder of models was given, as `sparse` of a capture."""
    models = largest_model(path, path.parent)
    if models is None:
        return ()
    root = _root_of_model(models.folder)
    return (Layout(name="COLMAP", root=root, path=models.folder, note=models.note),)


def _check_one(path: Path) -> None:
    """Refuse a folder of captures: which of them is meant, nobody said."""
    below = sorted(one for one in path.iterdir() if one.is_dir() and one.name[0] != ".")
    captures = [one for one in below if _is_posed(one)]
    if len(captures) > 1:
        raise SceneError(
            f"scene {path}: holds {len(captures)} captures with poses of their own in its "
            f"sub-folders; give the path of one: {', '.join(map(str, captures))}"
        )


def _is_posed(folder: Path) -> bool:
    """Whether a folder is a capture with poses, and no model of one that lies above."""
    if kind_of(folder) is not None:
        return _has_photos(folder)
    return bool(_posed(folder))


def _posed(folder: Path) -> Sequence[Layout]:
    return [one for one in layouts_of(folder) if one.name not in (PHOTOS, VIDEO)]


def _posed_above(found: Layout) -> str:
    """A note on poses that nobody asked for, since the folder of their photos was given."""
    if found.name != PHOTOS or found.root.name not in _PHOTO_FOLDERS:
        return ""
    above = _posed(found.root.parent)
    return f"poses beside {found.root} are not used; give {above[0].path} for them" if above else ""


def _has_photos(folder: Path) -> bool:
    return any(pictures_in(folder / name) for name in _PHOTO_FOLDERS)


def _root_of_model(folder: Path) -> Path:
    """The folder above a model that has its photos; the one it lies in where none has."""
    above = list(folder.parents)[:_UP]
    named = [up for up in above if (up / "images").is_dir() or (up / "input").is_dir()]
    return named[0] if named else folder.parent


def _of_phones(root: Path) -> Sequence[Layout]:
    places = {"Polycam": polycam_cameras(root), "Record3D": record3d_metadata(root)}
    return [
        Layout(name=name, root=root, path=path) for name, path in places.items() if path is not None
    ]


def _without_poses(root: Path) -> Sequence[Layout]:
    """Photos alone, or one video."""
    for name in _PHOTO_FOLDERS:
        folder = root / name
        if pictures_in(folder):
            return (Layout(name=PHOTOS, root=root, path=folder),)
    videos = _videos(root)
    if len(videos) == 1:
        return (Layout(name=VIDEO, root=root, path=videos[0]),)
    for name in () if videos else _PHOTO_FOLDERS:  # One sub-folder for each camera or walk.
        if photos_below(root / name):
            return (Layout(name=PHOTOS, root=root, path=root / name),)
    return ()


def _videos(root: Path) -> Sequence[Path]:
    return [
        path for path in sorted(root.iterdir()) if path.suffix.lower() in VIDEOS and path.is_file()
    ]


def _unknown(path: Path) -> str:
    several = _videos(path)
    if len(several) > 1:
        return f"scene {path}: holds {len(several)} videos; give the path of one"
    return (
        f"scene {path}: unknown format. Looked for: NeRF-Synthetic (transforms_train.json), "
        "PAPR in Motion (start/transforms_train.json and end/transforms_train.json), nerfstudio "
        "and instant-ngp (transforms.json), COLMAP (sparse/0), IDR and NeuS (cameras_sphere.npz), "
        "LLFF (poses_bounds.npy), NSVF (intrinsics.txt and pose), 3D Gaussian splatting "
        "(cameras.json), Polycam (keyframes), Record3D (metadata.json and rgb), photos or a video. "
        "Give the folder that holds one of them"
    )

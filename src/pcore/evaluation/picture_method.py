"""A folder of pictures as a method: DIR/STATE/VIEW.png, taken by any code.

Pictures with an alpha channel also tell opacity. A file VIEW.npy beside each, camera z (H, W) in
world units, tells depth. VIEW.npz, as `pcore render --raw` writes it, tells both by its arrays
`alpha` and `depth`.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np
import torch
from torch import Tensor

from pcore.data.image_files import read_header, read_rgba
from pcore.data.images import composite
from pcore.errors import InputError, SceneError
from pcore.evaluation.runner import Tells
from pcore.evaluation.states import State
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.validation import first_names

_ENDINGS = (".png", ".jpg", ".jpeg")
_NUMBERS, _ARRAYS = ".npy", ".npz"
_DEPTH, _ALPHA = "depth", "alpha"
"""Arrays of an .npz."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureMethod:
    """Pictures of another code.

    Attributes:
        name: for tables.
        folder: holds a folder for each state, with a picture for each test view.
        tells: what they say.
    """

    name: str
    folder: Path
    tells: Tells

    def pose(self, state: State) -> Mapping[int, Path]:
        """Find the picture of every shot.

        Raises:
            InputError: some are missing, or lack the alpha channel or depth that other pictures
                have; the message lists them, and files of other names.
        """
        place = self.folder / folder_of(state.name)
        if not place.is_dir():
            there = first_names(one.name for one in self.folder.iterdir() if one.is_dir())
            raise InputError(
                f"{self.folder}: expected a folder {place.name} with pictures of the state "
                f"{state.name}, got {there or 'no folder'}"
            )
        there = {one.stem: one for one in sorted(place.iterdir()) if _is_picture(one)}
        wanted = [shot.view.name for shot in state.shots]
        missing = [name for name in wanted if name not in there]
        if missing:
            odd = first_names(there[name].name for name in {*there} - {*wanted})
            raise InputError(
                f"{place}: expected a picture for each of {len(wanted)} test views, got none for "
                f"{first_names(missing)} ({len(missing)} missing)"
                + (f"; files that no view is called after: {odd}" if odd else "")
            )
        no_alpha = [one for one in wanted if self.tells != "colour" and not _clear([there[one]])[0]]
        expected = "opacity of every picture (alpha channel, or `alpha` in VIEW.npz) or none"
        _refuse_some(place, expected, no_alpha)
        no_depth = [one for one in wanted if self.tells == "depth" and not _tells_depth(there[one])]
        _refuse_some(place, "depth beside every picture (VIEW.npy or .npz) or none", no_depth)
        return {id(shot.camera): there[shot.view.name] for shot in state.shots}

    def draw(self, posed: Mapping[int, Path], camera: Camera) -> Image:
        """Read the picture of a camera of the state.

        Raises:
            InputError: damaged, or of another size.
        """
        path, size = posed[id(camera)], (camera.width, camera.height)
        try:
            header = read_header(path)
            if (header.width, header.height) != size:
                raise InputError(
                    f"{path}: expected {size[0]} x {size[1]} pixels as the true image, got "
                    f"{header.width} x {header.height}; compare at its resolution with --factor"
                )
            rgba = read_rgba(path, size=size)
        except SceneError as error:
            raise InputError(str(error)) from error
        depth, alpha = torch.full(rgba.shape[:2], torch.nan), rgba[..., 3]
        if self.tells == "depth":
            beside = path.with_suffix(_NUMBERS)
            depth = _numbers(beside if beside.is_file() else path.with_suffix(_ARRAYS), depth)
        if self.tells != "colour" and not header.has_alpha:
            alpha = _numbers(path.with_suffix(_ARRAYS), alpha, _ALPHA)
        return Image(
            rgb=composite(rgba, torch.ones(3)),
            alpha=alpha,
            depth=depth,
            surface=torch.full((*depth.shape, 3), torch.nan),
        )

    def health(self, posed: Mapping[int, Path], state: State) -> None:
        """Return nothing: pictures have no points."""
        del posed, state


def folder_of(state: str) -> str:
    """Name of the folder for a state; a colon is no letter of file names everywhere."""
    return state.replace(":", "_")


def open_pictures(name: str, folder: Path) -> PictureMethod:
    """Look at a folder of pictures.

    Raises:
        InputError: there is no such folder, or no picture in any folder of it.
    """
    if not folder.is_dir():
        raise InputError(f"--pictures {name}={folder}: expected a folder, found none")
    found = [one for one in sorted(folder.glob("*/*")) if _is_picture(one)]
    if not found:
        raise InputError(
            f"--pictures {name}={folder}: expected pictures named STATE/VIEW.png in it, for "
            "example canonical/r_0.png, found none"
        )
    # What one picture tells, `pose` asks of all: a missing file must not drop a metric in silence.
    clear, deep = any(_clear(found)), any(map(_tells_depth, found))
    tells: Tells = "depth" if clear and deep else "opacity" if clear else "colour"
    return PictureMethod(name=name, folder=folder, tells=tells)


def _refuse_some(place: Path, expected: str, lacking: Sequence[str]) -> None:
    if lacking:
        raise InputError(
            f"{place}: expected {expected}, in all states, got some without: "
            f"{first_names(lacking)} ({len(lacking)} in this state)"
        )


def _tells_depth(picture: Path) -> bool:
    return picture.with_suffix(_NUMBERS).is_file() or _holds(picture, _DEPTH)


def _holds(picture: Path, array: str) -> bool:
    """Whether an .npz beside a picture says that it has an array; a damaged one fails when read."""
    path = picture.with_suffix(_ARRAYS)
    if not path.is_file():
        return False
    try:
        with ZipFile(path) as arrays:
            return f"{array}.npy" in arrays.namelist()
    except (OSError, BadZipFile):
        return True


def _is_picture(path: Path) -> bool:
    return path.suffix.lower() in _ENDINGS


def _clear(pictures: Sequence[Path]) -> list[bool]:
    """Whether each picture that can be read tells opacity, itself or beside it.

    A damaged one fails its own state when it is drawn; all of them damaged is an error here.
    """
    found: list[bool] = []
    wrong: SceneError | None = None
    for path in pictures:
        try:
            found.append(read_header(path).has_alpha or _holds(path, _ALPHA))
        except SceneError as error:
            wrong = error
    if wrong is not None and not found:
        raise InputError(str(wrong)) from wrong
    return found


def _numbers(path: Path, like: Tensor, name: str = _DEPTH) -> Tensor:
    """An array (H, W) as large as another: of an .npy the only one, of an .npz that of a name."""
    what = "camera z" if name == _DEPTH else "opacity"
    try:
        found = np.load(path, allow_pickle=False)
        if isinstance(found, np.lib.npyio.NpzFile):
            with found as arrays:
                found = arrays[name]
    except (OSError, EOFError, ValueError, KeyError, BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: expected an array of {what}, got {error}") from error
    if found.shape != tuple(like.shape) or found.dtype.kind != "f":
        raise InputError(
            f"{path}: expected {what} {tuple(like.shape)} in floats, got {found.shape} of "
            f"{found.dtype}"
        )
    return torch.from_numpy(found).to(like)

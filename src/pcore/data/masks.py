"""What the masks of photos hold: the object, everything, or nothing."""

from __future__ import annotations

from collections.abc import Sequence

from pcore.data.scene import View
from pcore.errors import SceneError

_TRACE, _SOLID = 0.05, 0.5


def check_masks(views: Sequence[View]) -> tuple[str, ...]:
    """Refuse masks that hold nothing at all; say what is odd about the others. Decodes all images.

    Args:
        views: of one split.

    Returns:
        A sentence each.

    Raises:
        SceneError: no image shows anything of the object.
    """
    empty: list[str] = []
    whole: list[str] = []
    masked = [v for v in views if v.image.header.has_alpha or v.image.cut is not None]
    for view in masked:
        size = (view.camera.height, view.camera.width)
        alpha = view.image.rgba()[..., 3][view.image.shown().expand(*size)]
        if float(alpha.max()) <= _TRACE:
            empty.append(view.name)
        elif float(alpha.min()) > _SOLID:
            whole.append(view.name)
    if masked and len(empty) == len(views):
        raise SceneError(
            f"{views[0].image.path.parent}: expected masks that hold the object, got {len(empty)} "
            "images that are transparent all over, so there is nothing to learn; are the masks "
            "black, or was the alpha channel lost?"
        )
    notes: list[str] = []
    if masked and len(whole) == len(masked):
        notes.append(
            f"the alpha of all {len(whole)} images holds the whole picture: it is no mask, and "
            "they are taken for photos without one"
        )
    elif whole:
        notes.append(
            f"the masks of {_some(whole, len(views))} images hold the whole picture; if the object "
            "does not fill it, mend them, or give no image a mask"
        )
    if empty:
        notes.append(
            f"the masks of {_some(empty, len(views))} images hold nothing; if the object is in the "
            "picture, mend them, or remove these frames"
        )
    return tuple(notes)


def _some(names: Sequence[str], count: int) -> str:
    return f"{len(names)} of {count} ({', '.join(names[:5])}{', ...' * (len(names) > 5)})"

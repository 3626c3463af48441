"""What the trainings of both kinds of object say about a scene before, and check after."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from rich.console import Console

from pcore.asset.asset import Asset
from pcore.cli.console import say
from pcore.cli.diagnosing import note
from pcore.data.masks import check_masks
from pcore.data.scene import Scene
from pcore.errors import InputError, TrainingError
from pcore.training.hull import faint_share
from pcore.training.start_cloud import check_start, start_from_file

_LOOKS, _LOOK_SIDE, _LEAST_SIDE, _FAINT = 3, 64, 4, 0.02
"""Views that are looked at in the end, sizes of these pictures, and what opacity is nothing."""
EARLY = 50
"""Pictures of a training of fewer steps may still be empty."""
_HAZE = 0.5
"""More faint pixels than that per solid one are no rims (clean masks: `faint_share`)."""


def start_file(init: str, points: int | None) -> str:
    """Full path of the file that points start from; InputError where their number is given, too."""
    if points is not None:
        raise InputError(
            f"--points {points}: expected no number where the points come from a file, got --init "
            f"{init} as well; leave one of the options out"
        )
    return str(Path(init).resolve())


def warn_of_start(scene: Scene, start: str, console: Console, *, otherwise: str) -> None:
    """Warn where masks or a file would start points beside the object.

    Args:
        scene: to be trained on.
        start: where points begin.
        console: told of it.
        otherwise: the start that needs no masks.
    """
    views = scene.split("train")
    notes = [*check_masks(views)]
    share = faint_share(views) if start == "hull" else 0.0
    if share > _HAZE:
        notes.append(
            f"the masks are hazy: for 100 pixels that show the object, {100 * share:.0f} are 5 to "
            "50 % opaque, and points will start in all of that; clean the alpha channels, or start "
            f"without them: --init {otherwise}"
        )
    if start not in ("hull", otherwise):
        notes += check_start(start_from_file(Path(start)), views, start)
    note(console, notes)


def announce(console: Console, scene: Scene, plan: str) -> None:
    """Say in one line what is about to be trained."""
    views = scene.split("train")
    note(console, scene.notes)
    sizes = Counter((view.camera.width, view.camera.height) for view in views)
    width, height = sizes.most_common(1)[0][0]
    more = len(sizes) - 1
    others = f" (and {more} other size{'s' * (more > 1)})" * (more > 0)
    say(
        console,
        f"{scene.name}: {len(views)} training views of {width} x {height} pixels{others}; {plan}",
    )


def check_shows(asset: Asset, scene: Scene) -> None:
    """Raise TrainingError when an object shows nothing in any of a few training views."""
    views = scene.split("train")
    for view in views[:: max(1, len(views) // _LOOKS)][:_LOOKS]:
        scale = min(1.0, _LOOK_SIDE / max(view.camera.width, view.camera.height))
        width, height = (
            max(_LEAST_SIDE, round(scale * side))
            for side in (view.camera.width, view.camera.height)
        )
        picture = asset.render(None, view.camera.resized(width, height), samples=1)
        if bool((picture.alpha > _FAINT).any()):
            return
    raise TrainingError(
        f"{asset.path}: the run is saved, but nothing is to be seen in its pictures: the points "
        "are not where the photos show the object; check poses, masks and --init"
    )

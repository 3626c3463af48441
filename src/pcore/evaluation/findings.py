"""What stands out in a capture, each with what to do about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from pcore.capture.coverage import ONE_SIDE
from pcore.capture.layouts import RENDERED
from pcore.capture.triangulation import WRONG, PoseAgreement
from pcore.data.masks import check_masks
from pcore.errors import SceneError
from pcore.geometry.object_region import coordinates
from pcore.geometry.point_cloud import size_of

if TYPE_CHECKING:
    from pcore.evaluation.scene_check import SceneCheck

Level = Literal["warning", "note", "good"]

_FEW_VIEWS, _GAP = 20, 60.0
_PIXELS = 1.0
_SHOWN = 6
_WHOLE = 0.95
"""Share of the picture from which on a mask is taken for none."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing about a scene.

    Attributes:
        level: "warning" for what will cost quality, "note" for what one should know, "good".
        topic: one word or two.
        text: what was found, a sentence.
        action: what to do; empty where nothing is.
    """

    level: Level
    topic: str
    text: str
    action: str = ""


def findings(check: SceneCheck) -> tuple[Finding, ...]:
    """Judge what was measured; warnings come first."""
    found = [
        *_of_poses(check),
        *_of_coverage(check),
        *_of_photos(check),
        *_of_masks(check),
        *_of_region(check),
    ]
    order = {"warning": 0, "note": 1, "good": 2}
    return tuple(sorted(found, key=lambda one: order[one.level]))


def _of_poses(check: SceneCheck) -> list[Finding]:
    found: list[Finding] = []
    near = check.contradictions
    if near.still:
        found.append(_of_a_still_room(check))
    elif near.contradicting:
        worst = near.contradicting[0]
        names = [check.views[i].name for i in (worst.first, worst.second)]
        found.append(
            Finding(
                level="warning",
                topic="poses",
                text=f"{len(near.contradicting)} pairs of photos from nearly one place show "
                f"different things ({names[0]} and {names[1]}: {worst.degrees:.1f} degrees apart, "
                f"correlation {worst.alike:.2f}): the model of the room is folded or doubled",
                action="Do not learn the background: use masks (--masks auto). To mend the poses, "
                "run structure from motion on photos with more unique surroundings, or on half of "
                "them.",
            )
        )
    elif near.pairs:
        text = f"{len(near.pairs)} pairs of photos from nearly one place show the same things"
        found.append(Finding(level="good", topic="poses", text=text))
    else:
        text = "no two photos are near enough to one another to check poses by their pictures"
        found.append(Finding(level="note", topic="poses", text=text))
    if check.agreement is not None:
        found.append(_of_agreement(check, check.agreement))
    error = check.reprojection
    if error is not None:
        bad = error.doubtful()
        level: Level = "good" if error.mean <= _PIXELS and not bad else "warning"
        text = f"sparse points lie {error.mean:.2f} pixels from where the photos show them"
        text += f"; {_some(check, bad)} more than twice as far" if bad else ""
        action = "Leave those photos out (--fix), or run bundle adjustment again." if bad else ""
        found.append(Finding(level=level, topic="reprojection", text=text, action=action))
    return found


def _of_a_still_room(check: SceneCheck) -> Finding:
    text = (
        "the borders of all pictures show the same, though the poses say that the camera went "
        "around: a turntable before a room that stood still"
    )
    if check.masks is not None and not check.masks.automatic:
        action = "The masks take the room away; do not train without them."
        return Finding(level="note", topic="poses", text=text, action=action)
    action = "Cut the object out (--masks auto, with a --box where that fails, or masks of your "
    action += "own): by these poses the room cannot be learned, nor masks by it (--masks trained)."
    return Finding(level="warning", topic="poses", text=text, action=action)


def _of_agreement(check: SceneCheck, agreement: PoseAgreement) -> Finding:
    bad = agreement.doubtful()
    text = (
        f"features that {agreement.pairs} pairs of photos share lie {agreement.median:.2f} pixels "
        f"from the lines of their poses, {agreement.points:,} points are triangulated"
    )
    if agreement.median > WRONG:
        action = "The poses are not those of these photos: look for another order of the photos, "
        action += "other axes, intrinsics of another size, or a lens that is not undone."
        return Finding(level="warning", topic="pose check", text=text, action=action)
    if bad:
        text += f"; {_some(check, bad)} off"
        action = "Leave those photos out (--fix), or pose them again."
        return Finding(level="warning", topic="pose check", text=text, action=action)
    return Finding(level="good", topic="pose check", text=text)


def _of_coverage(check: SceneCheck) -> list[Finding]:
    cover, count = check.coverage, len(check.views)
    found: list[Finding] = []
    if count < _FEW_VIEWS:
        found.append(
            Finding(
                level="warning",
                topic="coverage",
                text=f"{count} photos are few",
                action="Take 50 to 100, in two or three rings around the object.",
            )
        )
    low, high = float(cover.elevation.min()), float(cover.elevation.max())
    text = (
        f"cameras stand within 30 degrees of {100 * cover.sphere:.0f} % of all directions, at "
        f"elevations {low:.0f} to {high:.0f}; the largest gap around is {cover.gap:.0f} degrees"
    )
    if cover.gap > _GAP:
        one_side = cover.gap > ONE_SIDE
        action = "What no photo shows stays empty or invented: edits that turn the object by more "
        action += "than the gap's edge show it. Take photos from there, or keep edits on this side."
        if one_side:
            action += " Orbits of pcore render swing in the part that is covered."
        found.append(
            Finding(
                level="note" if one_side else "warning",
                topic="coverage",
                text=text + (" (photographed from one side)" if one_side else ""),
                action=action,
            )
        )
    else:
        found.append(Finding(level="good", topic="coverage", text=text))
    return found


def _of_photos(check: SceneCheck) -> list[Finding]:
    quality, found = check.quality, list[Finding]()
    if quality.blurred:
        found.append(
            Finding(
                level="warning",
                topic="sharpness",
                text=f"{_some(check, quality.blurred)} less sharp than the photos around",
                action="Leave them out: pcore check SCENE --fix DIR writes a copy without them.",
            )
        )
    if quality.odd_exposure:
        found.append(
            Finding(
                level="warning",
                topic="exposure",
                text=f"{_some(check, quality.odd_exposure)} much brighter or darker than the rest",
                action="Lock the exposure, leave them out, or learn a colour per view.",
            )
        )
    elif quality.drifts:
        edges = torch.quantile(quality.stops, torch.tensor([0.05, 0.95]), dim=0)
        text = f"exposure or white balance drifts by {float((edges[1] - edges[0]).max()):.2f} steps"
        action = "Learn a colour per view (--exposure per-view)."
        found.append(Finding(level="note", topic="exposure", text=text, action=action))
    alone = len(check.views) - int(quality.compared.sum())
    if 2 * alone > len(check.views) and check.scene.layout != RENDERED:
        text = f"{alone} of {len(check.views)} photos are too far from others to compare exposure"
        action = "If the camera measured light anew for each, learn a colour per view (--exposure "
        action += "per-view)."
        found.append(Finding(level="note", topic="exposure", text=text, action=action))
    if not found:
        text = "no photo stands out by blur or exposure"
        found.append(Finding(level="good", topic="photos", text=text))
    sizes = {(view.camera.width, view.camera.height) for view in check.views}
    if len(sizes) > 1:
        text = f"photos of {len(sizes)} sizes: {', '.join(f'{w} x {h}' for w, h in sorted(sizes))}"
        found.append(Finding(level="note", topic="sizes", text=text))
    if check.scene.skipped:
        text = f"{len(check.scene.skipped)} pictures are not used; the list says why"
        found.append(Finding(level="note", topic="skipped", text=text))
    found += [Finding(level="note", topic="files", text=line) for line in check.scene.notes]
    return found


def _of_masks(check: SceneCheck) -> list[Finding]:
    masks = check.masks
    if masks is None:
        if check.no_masks:
            text = check.no_masks
            action = "Learn the room for a minute or two and take the object out of it (--masks "
            action += "trained). Without masks the background is learned too, and edits need a "
            action += "region (a box)."
            return [Finding(level="note", topic="masks", text=text, action=action)]
        return [
            Finding(
                level="note",
                topic="masks",
                text="the photos have no masks",
                action="The background is learned too, and edits need a region (a box). For the "
                "object alone: pcore check SCENE --masks auto, then train with --masks auto.",
            )
        ]
    odd = _odd_masks(check)
    doubtful = masks.doubtful()
    origin = "cut automatically" if masks.automatic else "of the scene"
    agree = sum(masks.agreement) / len(masks.agreement)
    text = f"masks {origin} agree with one hull by {100 * agree:.0f} % in the mean"
    if doubtful:
        odd.append(
            Finding(
                level="warning",
                topic="masks",
                text=f"{text}; {_some(check, doubtful)} doubtful",
                action="Look at them below. Write all with --masks-out DIR, correct what is wrong "
                "in any image editor, and train with --masks DIR; or give a tighter --box.",
            )
        )
    return odd or [Finding(level="good", topic="masks", text=text)]


def _odd_masks(check: SceneCheck) -> list[Finding]:
    """Masks that hold nothing or everything: they agree with one another and are none."""
    assert check.masks is not None, "asked for masks that are there"
    try:
        found = list(check_masks(check.views))
    except SceneError as problem:
        found = [str(problem)]
    share = torch.stack([mask.float().mean() / 255 for mask in check.masks.masks]).median()
    if share > _WHOLE:
        found.append(f"half of the masks hold {100 * float(share):.0f} % of the picture or more")
    action = "Mend them, or make others: --masks auto with a tighter --box, or --masks trained."
    return [Finding(level="warning", topic="masks", text=one, action=action) for one in found]


_SOURCES = {
    "box": "the box that was given",
    "files": "the scene's files",
    "masks": "the masks' hull",
    "points": "the dense part of the sparse points",
    "axes": "the viewing axes",
}


def _of_region(check: SceneCheck) -> list[Finding]:
    region = check.region
    text = (
        f"the object lies in {_said(region.bounds, region.radius)}, world units, by "
        f"{_SOURCES[check.source]}; cameras stand {check.coverage.distance.median():.4g} away"
    )
    if check.masks is None:
        action = region_advice(*region.bounds)
        if check.source == "axes":
            action = f"Give --box X Y Z X Y Z if that is not the object. {action}"
        return [Finding(level="note", topic="region", text=text, action=action)]
    if check.hull is not None:
        text += f"; the hull of the masks in it reaches over {_said(check.hull, region.radius)}"
    return [Finding(level="good", topic="region", text=text)]


def _said(corners: Iterable[Tensor], size: float) -> str:
    return " to ".join(f"({coordinates(corner, size)})" for corner in corners)


def region_advice(lower: Tensor, upper: Tensor) -> str:
    """What an edit of a scene with its background needs: a region, (3,) corners in world units."""
    size = size_of(torch.stack([lower, upper]))
    corners = (coordinates(corner, size) for corner in (lower, upper))
    box = '{{"shape": "box", "lower": [{}], "upper": [{}]}}'.format(*corners)
    return f'The background is learned too, so edits need a region: "region": {box}.'


def _some(check: SceneCheck, numbers: Sequence[int]) -> str:
    names = ", ".join(check.views[i].name for i in numbers[:_SHOWN])
    more = ", ..." * (len(numbers) > _SHOWN)
    verb = "is" if len(numbers) == 1 else "are"
    return f"{len(numbers)} of {len(check.views)} photos ({names}{more}) {verb}"

"""The report of a checked scene as one HTML page that needs nothing else."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from pcore.capture.pose_contradictions import NearPair
from pcore.data.scene import View
from pcore.evaluation.camera_drawing import camera_drawing
from pcore.evaluation.figures import data_uri
from pcore.evaluation.findings import Finding
from pcore.evaluation.report import filled_page
from pcore.evaluation.scene_check import SceneCheck
from pcore.geometry.object_region import coordinates
from pcore.training.forecast import Forecast

_SIDE, _QUALITY = 200, 80
_MOST_PAIRS, _MOST_PHOTOS = 4, 24
_VEIL = 0.22
"""How much of the background a masked picture still shows."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A picture of the page."""

    source: str
    title: str
    odd: bool = False


@dataclass(frozen=True, kw_only=True)
class CheckPage:
    """All that the page shows, from top to bottom."""

    title: str
    lead: str
    findings: tuple[Finding, ...]
    facts: tuple[tuple[str, str], ...]
    cameras: str
    pairs: tuple[tuple[Shown, Shown, str], ...]
    photos_title: str
    photos: tuple[Shown, ...]
    outliers: tuple[Shown, ...]
    skipped: tuple[tuple[str, str], ...]
    forecasts: tuple[tuple[str, str, str, str, str], ...]
    commands: tuple[str, ...]


def check_page(check: SceneCheck, commands: Sequence[str]) -> str:
    """Fill the page; every text is escaped.

    Args:
        check: what was measured.
        commands: what to type next.

    Raises:
        DependencyError: jinja2 is not installed.
    """
    return filled_page("pcore.evaluation", "check.html.j2", page=_page(check, commands))


def summary(check: SceneCheck) -> str:
    """One sentence about a checked scene."""
    count = sum(one.level == "warning" for one in check.findings)
    known = sum(one.level == "note" and bool(one.action) for one in check.findings)
    said = "nothing to mend" if count == 0 else f"{count} thing{'s' * (count > 1)} to look at"
    said += f", {known} to know" if known else ""
    return f"{len(check.views)} photos, {check.scene.layout}: {said}"


def facts(check: SceneCheck) -> tuple[tuple[str, str], ...]:
    """Name and value of what was read."""
    scene, views = check.scene, check.views
    splits = ", ".join(f"{name} {len(scene.split(name))}" for name in scene.splits)
    sizes = sorted({(view.camera.width, view.camera.height) for view in views})
    focal = [view.camera.focal[0] for view in views]
    bent = sum(view.image.lens is not None for view in views)
    lower, upper = (coordinates(corner, check.region.radius) for corner in check.region.bounds)
    rows = [
        ("layout", scene.layout),
        ("photos", splits),
        ("size", ", ".join(f"{w} x {h}" for w, h in sizes[:4]) + ", ..." * (len(sizes) > 4)),
        ("focal length", f"{min(focal):.0f} to {max(focal):.0f} pixels"),
        ("bent lenses", f"{bent}, straightened" if bent else "none"),
        ("sparse points", "none" if scene.sparse is None else f"{len(scene.sparse):,}"),
        ("region", f"({lower}) to ({upper}), world units"),
        ("cameras' distance", f"{float(check.coverage.distance.median()):.4g} world units"),
        ("pixel at the object", f"{views[0].camera.pixel_width(check.region.center):.3g} units"),
    ]
    return tuple(rows)


def forecast_row(one: Forecast) -> tuple[str, str, str, str, str]:
    """Kind and preset, time, memory, quality and how it is known, for people."""
    took = "-"
    if one.seconds is not None:
        took = f"{_duration(one.seconds)} of one core, within a factor of {one.within:g}"
    memory = "-" if one.memory is None else f"{one.memory / 1e9:.1f} GB"
    return f"{one.model}, {one.preset}", took, memory, one.quality or "-", one.how


def _duration(seconds: float) -> str:
    """Whole minutes, hours or days, whichever is read best."""
    if seconds < 90 * 60:
        return f"{max(1, round(seconds / 60))} min"
    hours = seconds / 3600
    return f"{hours:.2g} h" if hours < 72 else f"{hours / 24:,.0f} days"


def _page(check: SceneCheck, commands: Sequence[str]) -> CheckPage:
    near = check.contradictions.contradicting
    odd = {number for pair in near for number in (pair.first, pair.second)}
    outliers = [(i, "blurred") for i in check.quality.blurred]
    outliers += [(i, "exposure") for i in check.quality.odd_exposure]
    masked = check.masks is not None
    return CheckPage(
        title=f"Check of {check.scene.name}",
        lead=summary(check),
        findings=check.findings,
        facts=facts(check),
        cameras=camera_drawing(
            check.views,
            check.region,
            check.coverage,
            odd=odd | {i for i, _ in outliers},
            lines=[(pair.first, pair.second) for pair in near],
        ),
        pairs=tuple(_pair(check.views, pair) for pair in _different(near)),
        photos_title="Masks" if masked else "Photos",
        photos=tuple(_photo(check, i) for i in _chosen(check)),
        outliers=tuple(
            Shown(
                source=_uri(_rgb(check.views[i])), title=f"{check.views[i].name}: {why}", odd=True
            )
            for i, why in outliers[:_MOST_PHOTOS]
        ),
        skipped=tuple((one.name, one.reason) for one in check.scene.skipped),
        forecasts=tuple(forecast_row(one) for one in check.forecasts),
        commands=tuple(commands),
    )


def _different(near: Sequence[NearPair]) -> list[NearPair]:
    """The worst pairs that have no view in common."""
    chosen: list[NearPair] = []
    known: set[int] = set()
    for pair in near:
        if not known & {pair.first, pair.second} and len(chosen) < _MOST_PAIRS:
            chosen.append(pair)
            known |= {pair.first, pair.second}
    return chosen


def _chosen(check: SceneCheck) -> list[int]:
    """Numbers of the photos that are shown: doubtful ones first, then evenly."""
    count = len(check.views)
    step = max(1, -(-count // _MOST_PHOTOS))
    doubtful = [] if check.masks is None else list(check.masks.doubtful())
    if check.masks is not None:
        known = check.masks.agreement
        doubtful.sort(key=lambda i: known[i])
    rest = [i for i in range(0, count, step) if i not in doubtful]
    return [*doubtful, *rest][:_MOST_PHOTOS]


def _photo(check: SceneCheck, number: int) -> Shown:
    view = check.views[number]
    if check.masks is None:
        return Shown(source=_uri(_rgb(view)), title=view.name)
    mask, share = check.masks.masks[number], check.masks.agreement[number]
    return Shown(
        source=_uri(_veiled(_rgb(view), mask.float() / 255)),
        title=f"{view.name}: {100 * share:.0f} %",
        odd=number in check.masks.doubtful(),
    )


def _pair(views: Sequence[View], pair: NearPair) -> tuple[Shown, Shown, str]:
    shown = [
        Shown(source=_uri(_rgb(views[i])), title=views[i].name, odd=True)
        for i in (pair.first, pair.second)
    ]
    text = f"{pair.degrees:.1f} degrees and {100 * pair.apart:.0f} % of the cameras' distance apart"
    return shown[0], shown[1], f"{text}, correlation {pair.alike:.2f}"


def _rgb(view: View) -> Tensor:
    """The photo (H, W, 3) as it is, without its mask."""
    rgba = view.image.rgba()
    return rgba[..., :3]


def _veiled(rgb: Tensor, mask: Tensor) -> Tensor:
    """A photo whose background is faint and greenish, so that the object's rim shows."""
    behind = _VEIL * rgb + (1 - _VEIL) * torch.tensor([0.80, 0.93, 0.90])
    return rgb * mask[..., None] + behind * (1 - mask[..., None])


def _uri(rgb: Tensor) -> str:
    pixels = (255 * rgb.clamp(0, 1)).round().byte().numpy()
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    picture.thumbnail((_SIDE, _SIDE), Image.Resampling.LANCZOS)
    stream = io.BytesIO()
    picture.save(stream, format="JPEG", quality=_QUALITY)
    return data_uri(stream.getvalue(), "image/jpeg")

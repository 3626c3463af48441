"""What is shown beside the object to work with it: reach, axes, limits and cages of an edit."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from pcore.data.meshes import MeshFile
from pcore.deform.frame import axis_frame, axis_vector, bend_frame
from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.regions import FALLOFF
from pcore.editing.selection import Rim
from pcore.errors import PcoreError
from pcore.geometry.point_cloud import size_of
from pcore.studio.cage_handles import KINDS, cage_shapes
from pcore.studio.carrying import carried_places
from pcore.studio.edit_forms import AXES
from pcore.studio.editor import Editor
from pcore.studio.formula_handles import CENTRED
from pcore.studio.handle_edit import arriving, handle_points
from pcore.studio.handle_pose import triple

AXIS_COLORS = ((217, 57, 48), (62, 145, 65), (42, 98, 207))
_LINE = (255, 130, 0)
_CAGE = (0, 121, 107)
_CIRCLE = 48
_SAME = 1 - 1e-6
_BEYOND = 0.12
"""How far an axis goes beyond the object, in shares of its length there."""
_LOCKED = 0.35
"""Length of the line of a locked axis to both sides, in sizes of the object."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Guides:
    """Lines (L, 2, 3) with colours (L, 3) uint8, and the places (M, 3) of a dotted rim."""

    lines: Tensor
    colors: Tensor
    rim: Tensor


class GuideMaker:
    """Makes the guides of an editor; the last rim is kept, since a drag changes none."""

    def __init__(self) -> None:
        """Begin with no rim."""
        self._known: tuple[Any, Rim] | None = None

    def of(self, editor: Editor) -> Guides:
        """The guides of the selected edit as it is shown."""
        parts: list[tuple[Tensor, tuple[int, int, int]]] = []
        raw, rim = editor.present, torch.zeros(0, 3)
        if raw is not None:
            rim = self._rim(editor, raw)
            with contextlib.suppress(PcoreError):  # A file is gone: `Editor.lost` says so.
                parts = [*_shape(editor, raw), *_lock(editor)]
        lines = [one for one, _ in parts] or [torch.zeros(0, 2, 3, dtype=torch.float64)]
        colors = [torch.tensor(paint).expand(len(one), 3) for one, paint in parts]
        empty = [torch.zeros(0, 3, dtype=torch.int64)]
        return Guides(
            lines=torch.cat(lines), colors=torch.cat(colors or empty).to(torch.uint8), rim=rim
        )

    def _rim(self, editor: Editor, raw: dict[str, Any]) -> Tensor:
        """Where the handles' reach ends, or where a region has faded to nothing."""
        found = _reach(editor, raw)
        if found is None or len(editor.asset.points) < 2:
            return torch.zeros(0, 3)
        key = (found[0].tolist(), found[1])
        if self._known is None or self._known[0] != key:
            self._known = key, editor.selector.rim(*found)
        return self._known[1].at(editor.state.points.detach().cpu().float())


def _reach(editor: Editor, raw: dict[str, Any]) -> tuple[Tensor, float] | None:
    """Points (S,) and the length of the paths from them, beyond which an edit does nothing."""
    size, index = size_of(editor.asset.points), editor.shown.selected or 0
    points = arriving(editor.session.state, index).points
    if raw["type"] == "anchors":
        on = [one for one in handle_points(raw, points) if one is not None]
        return (torch.tensor(on), AnchorsEdit.reach_of(raw.get("reach"), size)) if on else None
    region = raw.get("region") or {}
    seam = region.get("falloff")
    seam = FALLOFF * size if seam is None else float(seam)
    if region.get("shape") == "points":
        return torch.tensor(region["ids"]), seam
    if region.get("shape") == "geodesic":
        away = (points - triple(region["center"])).norm(dim=1)
        return away.argmin().unsqueeze(0), float(region["radius"]) + seam
    return None


def _shape(editor: Editor, raw: dict[str, Any]) -> list[tuple[Tensor, tuple[int, int, int]]]:
    if raw["type"] in KINDS:
        shapes = cage_shapes(raw)
        found = [] if shapes is None else [(_edges(*shapes), _CAGE)]
    elif raw["type"] in CENTRED and "axis" in raw:
        found = _axis(raw, arriving(editor.session.state, editor.shown.selected or 0).points)
    else:
        return []
    state, index = editor.session.state, editor.shown.selected or 0
    return [(carried_places(lines, state, index), color) for lines, color in found]


def _edges(mesh: MeshFile, vertices: Tensor) -> Tensor:
    """Edges (E, 2, 3) of a mesh, each once; diagonals of sides that are flat at rest are none."""
    rest, faces = mesh.vertices.double(), mesh.faces
    around = torch.stack([faces, faces.roll(-1, dims=1)], dim=-1)
    corners = rest[faces]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1)
    length = (rest[around[..., 0]] - rest[around[..., 1]]).norm(dim=2)
    longest = (length >= length.amax(dim=1, keepdim=True) * _SAME).reshape(-1)
    edges, which = torch.unique(
        around.reshape(-1, 2).sort(dim=1).values, dim=0, return_inverse=True
    )
    sums = torch.zeros(len(edges), 3, dtype=torch.float64)
    sums.index_add_(0, which, normal.repeat_interleave(3, dim=0))
    always = torch.zeros(len(edges), dtype=torch.int64).index_add_(0, which, longest.long()) == 2
    flat = sums.norm(dim=1) > 2 * _SAME
    return vertices[edges[~(always & flat)]]


def _axis(raw: dict[str, Any], points: Tensor) -> list[tuple[Tensor, tuple[int, int, int]]]:
    """The axis of an edit, and circles where it begins and ends to act."""
    origin, bend = triple(raw.get("origin")), raw["type"] == "bend"
    frame = bend_frame(raw["axis"]) if bend else axis_frame(raw["axis"])
    driving = frame[0] if bend else frame[2]
    low, high = (float(one) for one in torch.aminmax((points - origin) @ driving))
    if raw.get("extent") is not None:
        low, high = raw["extent"]
    offset = points - origin
    across = offset - (offset @ driving).unsqueeze(1) * driving
    radius = float(across.norm(dim=1).quantile(0.95)) if len(points) else 0.0
    first, second = frame[1], torch.linalg.cross(driving, frame[1])
    turns = torch.linspace(0, 2 * math.pi, _CIRCLE + 1, dtype=torch.float64)
    circle = radius * (turns.cos()[:, None] * first + turns.sin()[:, None] * second)
    lines: list[Tensor] = []
    for share in raw.get("limits", (0.0, 1.0)):
        places = origin + (low + share * (high - low)) * driving + circle
        lines.append(torch.stack([places[:-1], places[1:]], dim=1))
    along = axis_vector(raw["axis"])
    ends = (low, high) if not bend else (-radius, radius)
    more = _BEYOND * (ends[1] - ends[0])
    # In parts, since later edits may bend it.
    steps = torch.linspace(ends[0] - more, ends[1] + more, _CIRCLE + 1, dtype=torch.float64)
    line = origin + steps.unsqueeze(1) * along
    return [(torch.cat([torch.stack([line[:-1], line[1:]], dim=1), *lines]), _LINE)]


def _lock(editor: Editor) -> list[tuple[Tensor, tuple[int, int, int]]]:
    """The line along which alone the selected handle moves."""
    number, handles = editor.shown.handle, editor.handles
    if editor.shown.lock == "off" or number is None or number >= len(handles):
        return []
    axis = AXES.index(editor.shown.lock)
    way = _LOCKED * size_of(editor.asset.points) * axis_vector(editor.shown.lock)
    place = triple(handles[number].place)
    return [(torch.stack([place - way, place + way]).unsqueeze(0), AXIS_COLORS[axis])]

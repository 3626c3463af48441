"""The toy snail of the embedded sample: a signed distance field, its mesh and its painted colours.

A field instead of a pile of primitives, because its zero set is one closed surface: parts blend
smoothly, nothing is hidden inside, and ambient occlusion is a few look-ups along the normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcore.sample.surface_nets import surface_nets

Array = NDArray[Any]

_LOWER = np.array([-1.14, -0.58, -0.60])
_UPPER = np.array([1.14, 0.66, 1.02])

# The shell is a tube along a logarithmic spiral in the plane y = const, drawn out sideways to a
# cone: after every turn radius, tube and remaining height shrink by the same ratio.
_SHELL_CENTER = np.array([-0.20, -0.08, 0.21])
_SHELL_RADIUS, _SHELL_TUBE, _SHELL_HEIGHT = 0.36, 0.36, 0.36
_SHELL_TURNS, _SHELL_START, _SHELL_RATIO = 2.1, -0.65, 0.42
_SHELL_LINKS = 60
_SHELL_BOUND, _SHELL_BOUND_OFFSET, _SHELL_BLEND = 0.70, np.array([0.02, 0.02, -0.02]), 0.035

_EYES = (
    (np.array([0.80, 0.12, 0.26]), np.array([0.90, 0.25, 0.62])),
    (np.array([0.80, -0.12, 0.26]), np.array([0.80, -0.27, 0.74])),
)
_EYE_RADIUS = 0.135
_STALK_RADIUS = 0.07


@dataclass(frozen=True, kw_only=True)
class PaintedMesh:
    """A closed triangle mesh with one colour per vertex.

    Attributes:
        vertices: (V, 3) float64, world units.
        faces: (F, 3) int32, counter-clockwise from outside.
        normals: (V, 3) float64, unit, outward.
        colors: (V, 3) float64 in [0, 1], with the light baked in.
    """

    vertices: Array
    faces: Array
    normals: Array
    colors: Array


def snail(step: float = 0.0115) -> PaintedMesh:
    """Mesh, paint and light the snail; largest vertex norm 1, longest edge about 2 `step`.

    Args:
        step: cell size of the grid that the field is sampled on, before normalising.
    """
    vertices, faces = surface_nets(_field, _LOWER, _UPPER, step)
    value, gradient = _field(vertices), _gradient(vertices)
    shift = value[:, None] * gradient / (gradient**2).sum(1, keepdims=True).clip(0.25)
    vertices = vertices - np.clip(shift, -0.5 * step, 0.5 * step)
    normals = _gradient(vertices)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    colors = _paint(vertices) ** 2.2 * _light(vertices, normals)[:, None]
    center = 0.5 * (vertices.min(0) + vertices.max(0))
    scale = 1.0 / np.linalg.norm(vertices - center, axis=1).max()
    return PaintedMesh(
        vertices=(vertices - center) * scale,
        faces=faces,
        normals=normals,
        colors=np.clip(colors, 0.0, 1.0) ** (1 / 2.2),
    )


def _gradient(points: Array) -> Array:
    """Gradient (M, 3) of the field from its values at the four corners of a tetrahedron."""
    width, corners = 2e-3, np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    values = np.stack([_field(points + width * corner) for corner in corners], axis=1)
    return values @ corners / (4 * width)


def _field(points: Array) -> Array:
    """Signed distance to the snail, (M, 3) -> (M,), negative inside, approximate far away."""
    eyes = np.minimum(*(_sphere(points, tip, _EYE_RADIUS) for _, tip in _EYES))
    soft = _smooth_min(_soft_body(points), eyes, 0.03)
    # The shell costs most; where a sphere around it is farther than the rest, it is not needed.
    around = _sphere(points, _SHELL_CENTER + _SHELL_BOUND_OFFSET, _SHELL_BOUND)
    near = around < soft + _SHELL_BLEND
    shell = np.maximum(around, _SHELL_BLEND + soft)
    shell[near] = _shell(points[near])[0]
    return _smooth_min(soft, shell, _SHELL_BLEND)


def _soft_body(points: Array) -> Array:
    path = [
        ([-0.98, 0.06, -0.45], 0.06),
        ([-0.55, 0.0, -0.36], 0.17),
        ([0.05, 0.0, -0.30], 0.23),
        ([0.50, 0.0, -0.30], 0.22),
        ([0.74, 0.0, -0.06], 0.19),
        ([0.80, 0.0, 0.18], 0.22),
    ]
    wide = points * np.array([1.0, 0.68, 1.0])
    body = np.full(len(points), np.inf)
    for (a, ra), (b, rb) in pairwise(path):
        body = _smooth_min(body, _round_cone(wide, np.array(a), np.array(b), (ra, rb)), 0.08)
    sole = -0.5 - points[:, 2]
    body = -_smooth_min(-body, -sole, 0.06)
    for root, tip in _EYES:
        stalk = _round_cone(points, root, tip, (_STALK_RADIUS + 0.02, _STALK_RADIUS))
        body = _smooth_min(body, stalk, 0.08)
    return body


def _shell(points: Array) -> tuple[Array, Array]:
    """Distance (M,) to the shell's spiral tube and the angle (M,) along it in radians."""
    angle = np.linspace(0.0, _SHELL_TURNS * 2 * np.pi, _SHELL_LINKS)
    size = _SHELL_RATIO ** (angle / (2 * np.pi))
    around = _SHELL_START + angle
    center = np.stack(
        [
            _SHELL_RADIUS * size * np.cos(around),
            _SHELL_HEIGHT * (1.0 - size),
            _SHELL_RADIUS * size * np.sin(around),
        ],
        axis=1,
    )
    tube = _SHELL_TUBE * size
    local = points - _SHELL_CENTER
    nearest = np.full(len(points), np.inf)
    where = np.zeros(len(points))
    for i in range(_SHELL_LINKS - 1):
        along = center[i + 1] - center[i]
        share = np.clip((local - center[i]) @ along / (along @ along), 0.0, 1.0)
        offset = local - center[i] - share[:, None] * along
        distance = np.sqrt((offset**2).sum(1)) - (tube[i] + share * (tube[i + 1] - tube[i]))
        closer = distance < nearest
        nearest = np.where(closer, distance, nearest)
        where = np.where(closer, angle[i] + share * (angle[i + 1] - angle[i]), where)
    return nearest, where


def _round_cone(points: Array, a: Array, b: Array, radii: tuple[float, float]) -> Array:
    along = b - a
    share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
    offset = points - a - share[:, None] * along
    return np.sqrt((offset**2).sum(1)) - (radii[0] + share * (radii[1] - radii[0]))


def _sphere(points: Array, center: Array, radius: float) -> Array:
    return np.sqrt(((points - center) ** 2).sum(1)) - radius


def _smooth_min(a: Array, b: Array, width: float) -> Array:
    """Minimum that rounds the crease between two fields over `width` (cubic blend)."""
    finite = np.minimum(np.abs(a - b), width)
    return np.minimum(a, b) - (width - finite) ** 3 / (6 * width**2)


def _light(points: Array, normals: Array) -> Array:
    """Baked brightness (M,): sky, a key light, a weak fill from below, ambient occlusion."""
    key = np.array([0.45, -0.55, 0.70])
    diffuse = np.clip(normals @ (key / np.linalg.norm(key)), 0.0, None)
    sky = 0.5 + 0.5 * normals[:, 2]
    occlusion = np.ones(len(points))
    for reach in (0.04, 0.09, 0.16):
        free = np.clip(_field(points + reach * normals) / reach, 0.0, 1.0)
        occlusion *= 0.55 + 0.45 * free
    return (0.38 + 0.32 * sky + 0.50 * diffuse) * (0.35 + 0.65 * occlusion)


def _paint(points: Array) -> Array:
    """Colour (M, 3) of the surface before light, display values in [0, 1]."""
    shell, angle = _shell(points)
    eyes = np.stack([_sphere(points, tip, _EYE_RADIUS) for _, tip in _EYES])
    parts = np.stack([_soft_body(points), eyes.min(0), shell])
    part = parts.argmin(0)[:, None]
    color = np.where(part == 0, _paint_body(points), _paint_shell(points, angle))
    return np.where(part == 1, _paint_eyes(points), color)


def _paint_shell(points: Array, angle: Array) -> Array:
    """Chequered: fields along the spiral and around its tube, the hue drifting inwards."""
    palette = np.array(
        [[0.86, 0.10, 0.16], [0.96, 0.45, 0.06], [0.99, 0.78, 0.10], [0.80, 0.12, 0.55]]
    )
    cream = np.array([1.0, 0.91, 0.68])
    field = np.floor(angle / (2 * np.pi) * 10.0).astype(int)
    size = _SHELL_RATIO ** (angle / (2 * np.pi))
    middle = _SHELL_CENTER[1] + _SHELL_HEIGHT * (1.0 - size)
    side = (points[:, 1] > middle + 0.25 * _SHELL_TUBE * size).astype(int)
    other = (points[:, 1] < middle - 0.45 * _SHELL_TUBE * size).astype(int)
    odd = (field + side + other) % 2 == 1
    return np.where(odd[:, None], cream, palette[(field // 2) % len(palette)])


def _paint_body(points: Array) -> Array:
    lime, teal = np.array([0.62, 0.86, 0.20]), np.array([0.04, 0.66, 0.62])
    share = np.clip((points[:, 2] + 0.42) / 0.30, 0.0, 1.0)
    share = share * share * (3 - 2 * share)
    color = lime + share[:, None] * (teal - lime)
    ripple = np.sin(9.0 * points[:, 0] + 2.0 * np.sin(7.0 * points[:, 1]))
    ripple += np.sin(11.0 * points[:, 2] + 4.0 * points[:, 0])
    color = color * (1.0 - 0.22 * (ripple[:, None] > 0.9))
    band = np.sin(13.0 * points[:, 0] + 6.0 * np.abs(points[:, 1])) > 0
    sole = (points[:, 2] < -0.48) & band
    color = np.where(sole[:, None], np.array([0.98, 0.72, 0.25]), color)
    spots = np.array([[-0.72, 0.075], [-0.42, 0.085], [-0.08, 0.09], [0.26, 0.085], [0.56, 0.07]])
    for x, radius in spots:
        inside = (points[:, 0] - x) ** 2 + (points[:, 2] + 0.30) ** 2 < radius**2
        color = np.where(inside[:, None], np.array([0.15, 0.25, 0.75]), color)
    return _paint_face(points, color)


def _paint_face(points: Array, color: Array) -> Array:
    """Pink cheeks, orange feelers: they tell front from back and left from right."""
    for y in (0.21, -0.21):
        cheek = _sphere(points, np.array([0.95, y, 0.12]), 0.10) < 0
        color = np.where(cheek[:, None], np.array([0.98, 0.45, 0.55]), color)
    for (root, tip), tint in zip(_EYES, ([0.97, 0.55, 0.08], [0.60, 0.25, 0.80]), strict=True):
        along = (points - root) @ (tip - root) / ((tip - root) @ (tip - root))
        color = np.where((along > 0.42)[:, None] & (points[:, 2:] > 0.30), np.array(tint), color)
    return color


def _paint_eyes(points: Array) -> Array:
    color = np.broadcast_to(np.array([1.0, 0.94, 0.62]), (len(points), 3))
    for (_, tip), side in zip(_EYES, (0.25, -0.25), strict=True):
        look = np.array([0.95, side, 0.12])
        pupil = _sphere(points, tip + _EYE_RADIUS * look / np.linalg.norm(look), 0.082) < 0
        color = np.where(pupil[:, None], np.array([0.08, 0.08, 0.14]), color)
    return color

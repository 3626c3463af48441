"""Shadow maps made of points: what is hidden, and by which point."""

from __future__ import annotations

import math

import pytest
import torch

from pcore.relight import shadows
from pcore.relight.lamps import sphere
from pcore.relight.relight_config import DEFAULT, RelightConfig
from pcore.relight.shadows import shadows_of

UP = torch.tensor([[0.0, 0.0, 1.0]])
STEP = 0.05
COARSE = RelightConfig(shadow_finest=64)


def plate(height: float, side: int = 40) -> torch.Tensor:
    """A square grid (side * side, 3) around the z axis."""
    steps = (torch.arange(side) - (side - 1) / 2) * STEP
    grid = torch.cartesian_prod(steps, steps)
    return torch.cat([grid, torch.full((side * side, 1), height)], dim=1)


def unshadowed(
    points: torch.Tensor,
    directions: torch.Tensor,
    spacing: float,
    config: RelightConfig = DEFAULT,
    *,
    normals: torch.Tensor | None = None,
) -> torch.Tensor:
    """What is open to points, whose normals are not known unless they are given."""
    normals = torch.zeros_like(points) if normals is None else normals
    return shadows_of(points, normals, directions, spacing, config).open


def test_a_lid_hides_what_is_below_it_from_above_only() -> None:
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    found = unshadowed(points, torch.cat([UP, -UP]), STEP)
    assert found.shape == (2000, 2)
    flat = points[:1600, :2].abs().amax(dim=1)
    above = found[:1600, 0]
    assert (above[flat < 0.45] == 0).all()
    assert (above[flat > 0.6] == 1).all()
    assert (found[1600:, 0] == 1).all(), "nothing is above the lid"
    assert (found[:1600, 1] == 1).all()
    assert (found[1600:, 1] == 0).all()


def test_the_edge_of_a_shadow_is_soft() -> None:
    lid = plate(1.0, side=20) + torch.tensor([STEP / 3, STEP / 3, 0.0])
    points = torch.cat([plate(0.0), lid])
    above = unshadowed(points, UP, STEP)[:1600, 0]
    between = (above > 0) & (above < 1)
    assert between.any()
    assert (points[:1600][between, :2].abs().amax(dim=1) - 0.5).abs().max() < 2.5 * STEP


def test_shadows_fall_away_from_the_light() -> None:
    """A lid that is as high as it is far to the side, under a light from 45 degrees."""
    lid = plate(1.0, side=20)
    slanted = torch.nn.functional.normalize(torch.tensor([[1.0, 0.0, 1.0]]), dim=1)
    lid[:, 0] += 1.0
    found = unshadowed(torch.cat([plate(0.0), lid]), slanted, STEP)[:1600, 0]
    middle = plate(0.0)[:, :2].abs().amax(dim=1) < 0.4
    assert (found[middle] == 0).all()
    mirrored = slanted * torch.tensor([[-1.0, 1.0, 1.0]])
    assert (unshadowed(torch.cat([plate(0.0), lid]), mirrored, STEP)[:1600, 0][middle] == 1).all()


def test_a_shell_as_thick_as_points_lie_does_not_hide_itself() -> None:
    points = sphere(4000) * (1 + 0.02 * torch.randn(4000, 1))
    spacing = 0.06
    directions = sphere(30)
    for normals in (None, torch.nn.functional.normalize(points, dim=1)):
        check_ball(points, directions, unshadowed(points, directions, spacing, normals=normals))


def check_ball(points: torch.Tensor, directions: torch.Tensor, found: torch.Tensor) -> None:
    facing = points @ directions.T
    assert float(found[facing > 0.5].mean()) > 0.97
    assert float(found[facing < -0.5].mean()) < 0.03


@pytest.mark.parametrize("scale", [0.25, 4.0])
def test_sizes_and_places_do_not_matter(scale: float) -> None:
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    directions = sphere(20)
    expected = unshadowed(points, directions, STEP)
    found = unshadowed(scale * points, directions, scale * STEP)
    assert torch.equal(found, expected)
    moved = unshadowed(points + torch.tensor([4.0, -8.0, 2.0]), directions, STEP)
    assert float((moved - expected).abs().mean()) < 1e-3


def test_points_without_a_spacing_hide_nothing() -> None:
    for points in (torch.zeros(1, 3), torch.ones(5, 3), torch.randn(5, 3)):
        assert (unshadowed(points, UP, 0.0) == 1).all()
        found = shadows_of(points, torch.zeros_like(points), UP, 0.0)
        assert found.hider[:, 0].tolist() == list(range(len(points)))


@pytest.mark.parametrize(
    ("faces", "lit", "hidden"), [(-1.0, 0.5, 1.5), (0.0, 3.0, 4.0), (1.0, 7.0, 9.0)]
)
def test_what_is_less_deep_than_a_surface_is_thick_is_lit(
    faces: float, lit: float, hidden: float
) -> None:
    """What faces away from the light is the underside of something else: it hides what is near."""
    for spacings, share in ((lit, 1.0), (hidden, 0.0)):
        points = torch.cat([plate(0.0), plate(spacings * STEP, side=20)])
        normals = torch.cat([UP.expand(1600, 3), faces * UP.expand(400, 3)])
        found = unshadowed(points, UP, STEP, normals=normals)[:1600, 0]
        assert (found[points[:1600, :2].abs().amax(dim=1) < 0.4] == share).all()


def test_a_thin_sheet_in_slanting_light_does_not_hide_itself() -> None:
    """Its other side is nearer to the light some way up, and yet behind it."""
    both = torch.cat([plate(0.0), plate(-0.4 * STEP)])
    normals = torch.cat([UP.expand(1600, 3), -UP.expand(1600, 3)])
    for angle in (30.0, 60.0, 80.0):
        light = torch.tensor([[math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))]])
        assert (unshadowed(both, light, STEP, normals=normals)[:1600] == 1).all()
    assert (unshadowed(both, light, STEP)[:1600] < 1).any(), "without normals it does"


def test_light_from_behind_a_surface_is_not_looked_for() -> None:
    normals = UP.expand(1600, 3)
    assert (unshadowed(plate(0.0), -UP, STEP, normals=normals) == 0).all()
    assert (unshadowed(plate(0.0), UP, STEP, normals=normals) == 1).all()
    alone = shadows_of(torch.zeros(1, 3), UP, torch.cat([UP, -UP]), 0.0)
    assert alone.open.tolist() == [[1.0, 0.0]]


def test_the_lowest_point_that_faces_down_is_what_hides() -> None:
    """Three lids: one that faces up lies lowest, two that face down above it."""
    heights, faces = (0.6, 1.0, 1.4), (1.0, -1.0, -1.0)
    lids = [plate(height, side=20) for height in heights]
    points = torch.cat([plate(0.0), *lids])
    normals = torch.cat([UP.expand(1600, 3), *(face * UP.expand(400, 3) for face in faces)])
    found = shadows_of(points, normals, UP, STEP)
    middle = points[:1600, :2].abs().amax(dim=1) < 0.4
    hiders = points[found.hider[:1600, 0][middle].long()]
    assert (hiders[:, 2] == 1.0).all()
    offsets = (hiders - points[:1600][middle])[:, :2].abs()
    assert float(offsets.max()) < 3 * STEP
    outside = points[:1600, :2].abs().amax(dim=1) > 0.7
    itself = torch.arange(1600)[outside]
    assert torch.equal(found.hider[:1600, 0][outside].long(), itself)
    # Nothing faces down: the lowest of all, also where less of it would have been hidden below it.
    normals[1600:] = UP
    normals[2000:] = 0
    hiders = shadows_of(points, normals, UP, STEP).hider[:1600, 0][middle].long()
    assert (points[hiders, 2] == heights[0]).all()


def test_it_is_what_loops_over_all_points_find() -> None:
    """Word for word: nine cells around a point, each open where no point beside it is higher."""
    generator = torch.Generator().manual_seed(2)
    points = torch.rand(150, 3, generator=generator)
    normals = torch.nn.functional.normalize(torch.randn(150, 3, generator=generator), dim=1)
    normals[::5] = 0
    spacing, cell = 0.12, DEFAULT.shadow_cell * 0.12
    middle = (points.amin(dim=0) + points.amax(dim=0)) / 2
    directions = sphere(7)
    found = shadows_of(points, normals, directions, spacing)
    right = shadows.perpendicular(directions)
    up = torch.linalg.cross(directions, right)
    for look, direction in enumerate(directions):
        place = points - middle
        column = torch.floor(place @ right[look] / cell).long()
        row = torch.floor(place @ up[look] / cell).long()
        facing, height = normals @ direction, place @ direction
        back, unknown, front = DEFAULT.shadow_depths
        depth = torch.full((150,), front)
        depth[facing < 0] = back
        depth[::5] = unknown
        for point in range(150):
            if facing[point] <= 0 and point % 5 != 0:
                assert found.open[point, look] == 0
                continue
            above = height - depth * spacing > height[point]
            above &= (points - points[point]) @ normals[point] >= 0
            closed, hides = 0, torch.zeros(150, dtype=torch.bool)
            for a in (-1, 0, 1):
                for b in (-1, 0, 1):
                    near = (column - column[point] - a).abs() <= 1
                    near &= (row - row[point] - b).abs() <= 1
                    closed += bool((near & above).any())
                    hides |= near & above
            assert float(found.open[point, look]) == pytest.approx(1 - closed / 9), (look, point)
            if closed:
                down = hides & (facing < 0)
                chosen = down if bool(down.any()) else hides
                lowest = height.masked_fill(~chosen, torch.inf).argmin()
                assert int(found.hider[point, look]) == int(lowest)
            else:
                assert int(found.hider[point, look]) == point


def test_threads_change_nothing() -> None:
    points, directions = torch.randn(300, 3), sphere(25)
    expected = shadows_of(points, torch.zeros_like(points), directions, 0.2)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    found = shadows_of(points, torch.zeros_like(points), directions, 0.2)
    torch.set_num_threads(before)
    assert torch.equal(found.open, expected.open)
    assert torch.equal(found.hider, expected.hider)


def test_maps_have_no_more_cells_than_that() -> None:
    """With a stray point far away a lid lies within the surface of a coarse map."""
    points = torch.cat([plate(0.0), plate(1.0, side=20)])
    far = torch.cat([points, torch.tensor([[1e3, 0.0, 0.0]])])
    middle = points[:1600, :2].abs().amax(dim=1) < 0.4
    assert (unshadowed(points, UP, STEP)[:1600, 0][middle] == 0).all()
    assert (unshadowed(far, UP, STEP, COARSE)[:1600, 0][middle] == 1).all()


def test_a_stray_point_makes_maps_coarse_and_nothing_dark() -> None:
    """A slope that lies in one cell does not hide itself."""
    slope = plate(0.0)
    slope[:, 2] = slope[:, 0]
    points = torch.cat([slope, torch.tensor([[1e4, 0.0, 0.0]])])
    assert (unshadowed(points, UP, STEP, COARSE)[:1600] == 1).all()
